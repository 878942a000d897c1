// Parts of the page, fetched anew at the page's own address, and put in place where they differ.
import { passedMs } from "./clock.js";

const BYTES_PER_S = 4800; // on average, events and all; the first fetch after a quiet while is at once
const HEAD_BYTES = 400; // of an answer, more or less
const LEAST_MS = 200;
const AGAIN_MS = 1500;

const wanted = new Set();
const shown = [];
const lost = [];
let timer = null;
let loading = false;
let freeAt = 0;
let spent = 0; // bytes of events since the last fetch

/** Be told when parts were put in place, with the service's time. */
export function whenShown(call) { shown.push(call); }

/** Be told when parts could not be fetched. */
export function whenLost(call) { lost.push(call); }

/** Count what came otherwise: the next fetch waits for as much longer. */
export function spend(bytes) { spent += bytes; }

function parts() { return [...document.querySelectorAll("[data-part]")]; }

// As they came with the page, before anything is changed in them: what is the same again is left as it is.
for (const part of parts()) part.fetched = part.outerHTML;

/** Fetch the parts that an event of this kind concerns. */
export function refreshFor(kind) {
  refresh(parts().filter((part) => part.dataset.on.split(" ").includes(kind)).map((part) => part.dataset.part));
}

/** Fetch parts soon: a list of names, or "all". */
export function refresh(names) {
  for (const name of names === "all" ? parts().map((part) => part.dataset.part) : names) wanted.add(name);
  plan();
}

function plan() {
  if (timer !== null || loading || wanted.size === 0) return;
  timer = setTimeout(load, Math.max(0, freeAt - passedMs()));
}

async function load() {
  timer = null;
  loading = true;
  const names = [...wanted];
  wanted.clear();
  let bytes = 0;
  const before = Math.min(spent, BYTES_PER_S); // of a quiet while little is owed
  spent = 0;
  let againMs = LEAST_MS;
  try {
    const answer = await fetch(location.href, { headers: { "Robomend-Parts": names.join(",") } });
    againMs = Math.max(LEAST_MS, Number(answer.headers.get("robomend-again-ms") ?? 0)); // with many pages: longer
    if (answer.ok) {
      bytes = Number(answer.headers.get("content-length") ?? 0) + HEAD_BYTES;
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      const again = place(page);
      const now = page.querySelector("[data-now-ms]");
      for (const call of shown) call(now ? Number(now.dataset.nowMs) : 0);
      if (again.length) setTimeout(() => refresh(again), AGAIN_MS);
    } else if (answer.status === 401) {
      for (const call of lost) call("signed out; reload the page to sign in");
    } else {
      for (const call of lost) call(`the service says ${answer.status}`);
      if (answer.status >= 429) setTimeout(() => refresh(names), AGAIN_MS);
    }
  } catch {
    for (const call of lost) call("the service does not answer");
    setTimeout(() => refresh(names), AGAIN_MS);
  }
  loading = false;
  freeAt = passedMs() + Math.max(againMs, (bytes + before) / BYTES_PER_S * 1000);
  plan();
}

/** Put parts in place; return those to be fetched again. */
function place(page) {
  const again = [];
  for (const fresh of page.querySelectorAll("[data-part]")) {
    const old = document.querySelector(`[data-part="${CSS.escape(fresh.dataset.part)}"]`);
    if (!old) continue;
    if (fresh.hasAttribute("data-again")) again.push(fresh.dataset.part);
    const text = fresh.outerHTML;
    if (old.fetched === text) continue;
    const focused = old.contains(document.activeElement) ? document.activeElement : null;
    const typing = focused?.matches("input, textarea, select");
    if (typing && !fresh.hasAttribute("data-always")) { // nobody is disturbed while typing, unless by the stop
      focused.addEventListener("blur", () => setTimeout(() => refresh([fresh.dataset.part]), 300), { once: true });
      continue;
    }
    keep(old, fresh);
    old.replaceWith(fresh);
    fresh.fetched = text;
    if (focused) (focused.id && document.getElementById(focused.id) || same(fresh, focused))?.focus({ preventScroll: true });
  }
  return again;
}

/** Keep what a person opened, typed and scrolled to. */
function keep(old, fresh) {
  for (const details of old.querySelectorAll("details[id]")) {
    const other = fresh.querySelector(`#${CSS.escape(details.id)}`);
    if (other) other.open = details.open;
  }
  for (const field of old.querySelectorAll("input[name]:not([type=hidden]), textarea[name], select[name]")) {
    const form = field.form?.getAttribute("action");
    const other = form && fresh.querySelector(`form[action="${CSS.escape(form)}"] [name="${CSS.escape(field.name)}"]`);
    if (other && field.value !== field.defaultValue) other.value = field.value;
  }
  const scrolled = [...old.querySelectorAll("[data-scroll]")].map((box) => [box.dataset.scroll, box.scrollLeft, box.scrollTop]);
  queueMicrotask(() => {
    for (const [name, left, top] of scrolled) {
      fresh.querySelector(`[data-scroll="${CSS.escape(name)}"]`)?.scrollTo(left, top);
    }
  });
}

/** Return what stands for the focused link or button in the fresh part. */
function same(fresh, focused) {
  const address = focused.getAttribute("href");
  if (address) return fresh.querySelector(`a[href="${CSS.escape(address)}"]`);
  // Rather nothing than another answer: whoever is on "No" must not press "Yes" because the page changed.
  const form = (each) => each.form?.getAttribute("action");
  return [...fresh.querySelectorAll("button, input:not([type=hidden]), textarea, select, summary, [tabindex]")].find(
    (each) => each.tagName === focused.tagName && each.name === focused.name && form(each) === form(focused)
      && (each.tagName !== "BUTTON" || each.value === focused.value)
      && (each.matches("input, textarea, select") || each.textContent === focused.textContent));
}
