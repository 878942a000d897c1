// What makes the page live: parts that are fetched when an event concerns them, forms that stay
// where they are. Without it everything works as well, by reloading.
import { passedMs } from "./clock.js";
import { Live } from "./live.js";
import { refresh, whenShown } from "./parts.js";

const body = document.body;
const said = document.getElementById("said");
let hiding;

/** Say something for a while, to eyes and screen readers alike. */
function say(text, wrong = false) {
  said.textContent = text;
  said.className = wrong ? "wrong" : "";
  said.hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(() => { said.hidden = true; }, wrong ? 12000 : 5000);
}

let beganMs = Number(body.dataset.nowMs) - passedMs(); // by the service's clock

function ago(time) {
  const seconds = Math.round((beganMs + passedMs() - Number(time.dataset.ms)) / 1000);
  return seconds < 0 ? `in ${age(-seconds)}` : `${age(seconds)} ago`;
}

// Of a time that is pointed at, its title says how long ago it was, by the service's clock: this computer's may be
// minutes off.
document.addEventListener("pointerover", (event) => {
  const time = event.target.closest?.("time[data-ms]");
  if (time) time.title = `${ago(time)}, ${time.title.replace(/^.* (ago|in .*), /, "")}`;
});

function age(seconds) {
  if (seconds < 100) return `${seconds} s`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

whenShown((nowMs) => {
  if (nowMs) beganMs = nowMs - passedMs();
});

// --- forms

document.addEventListener("submit", async (event) => {
  const form = event.target;
  if (!form.matches("form[data-live]")) return;
  event.preventDefault();
  const button = event.submitter ?? form.querySelector("button");
  const fields = new URLSearchParams(new FormData(form, event.submitter));
  button.disabled = true;
  try {
    const answer = await fetch(form.action, { method: "POST", body: fields, redirect: "manual" });
    if (answer.ok || answer.type === "opaqueredirect") {
      say(event.submitter?.dataset.live || form.dataset.live || "Done.");
      form.reset();
    } else {
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      say(page.getElementById("problem")?.textContent ?? `It was refused (${answer.status}).`, true);
    }
  } catch {
    say("The service does not answer: nothing is known to be done. Try again.", true);
  }
  button.disabled = false;
  refresh("all");
});

// The search goes on while one types.
const search = document.querySelector('input[type="search"]');
let searching;
search?.addEventListener("input", () => {
  clearTimeout(searching);
  searching = setTimeout(() => {
    const address = new URL(location.href);
    address.searchParams.set("q", search.value);
    address.searchParams.delete("page");
    if (!search.value) address.searchParams.delete("q");
    history.replaceState(null, "", address);
    refresh("all");
  }, 150);
});
document.addEventListener("keydown", (event) => {
  if (event.key === "/" && search && !event.target.matches("input, textarea, select")) {
    event.preventDefault();
    search.focus();
  }
});

// Escape closes the innermost thing that is open around what is focused, and leaves the focus on what opened it.
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  if (!said.hidden) { said.hidden = true; return; }
  const open = event.target.closest?.("details[open]");
  if (!open) return;
  open.open = false;
  open.querySelector("summary").focus();
});

// --- events

if (body.dataset.events) new Live(body.dataset.events, Number(body.dataset.pingS)).start();

// --- a robot: what has no event of its own is fetched now and then, the graph can be made larger

setInterval(() => {
  if (document.hidden) return;
  const due = document.querySelectorAll("[data-every-ms]");
  if (due.length) refresh([...due].map((part) => part.dataset.part));
}, 2000);

let zoom = null; // null: as wide as there is room
function drawGraph() {
  const graph = document.querySelector("svg.graph");
  if (!graph) return;
  const box = graph.viewBox.baseVal;
  graph.classList.toggle("zoomed", zoom !== null);
  graph.setAttribute("width", Math.round(box.width * (zoom ?? 1)));
  graph.setAttribute("height", Math.round(box.height * (zoom ?? 1)));
}
whenShown(drawGraph);
document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-zoom]");
  if (!button) return;
  const graph = document.querySelector("svg.graph");
  const shown = graph.getBoundingClientRect().width / graph.viewBox.baseVal.width;
  if (button.dataset.zoom === "fit") zoom = Math.min(1.5, (graph.parentElement.clientWidth - 4) / graph.viewBox.baseVal.width);
  else zoom = Math.min(4, Math.max(0.1, shown * Number(button.dataset.zoom)));
  drawGraph();
});

/** Show what a thing of the graph rests on, while it is pointed at or focused. */
function trace(event) {
  const thing = event.target.closest?.(".graph .thing") ?? event.target.querySelector?.(":scope > .thing");
  const graph = document.querySelector("svg.graph");
  if (!graph || (!thing && !graph.classList.contains("tracing"))) return;
  for (const one of graph.querySelectorAll(".upstream")) one.classList.remove("upstream");
  graph.classList.toggle("tracing", !!thing);
  if (!thing) return;
  const edges = [...graph.querySelectorAll(".edge")], found = new Set([thing.dataset.n]), waiting = [thing.dataset.n];
  while (waiting.length) {
    const to = waiting.pop();
    for (const edge of edges) {
      if (edge.dataset.to !== to) continue;
      edge.classList.add("upstream");
      if (!found.has(edge.dataset.from)) { found.add(edge.dataset.from); waiting.push(edge.dataset.from); }
    }
  }
  for (const one of graph.querySelectorAll(".thing")) one.classList.toggle("upstream", found.has(one.dataset.n));
}
document.addEventListener("pointerover", trace);
document.addEventListener("focusin", trace);

// The latest is at the right end of the timeline, which is wider than a phone.
for (const box of document.querySelectorAll('[data-scroll="past"]')) box.scrollLeft = box.scrollWidth;

/** Open the explanation that a link of the graph leads to. */
function explain() {
  const why = location.hash.startsWith("#why-") && document.querySelector(location.hash);
  if (!why) return;
  why.open = true;
  why.scrollIntoView({ block: "center" });
  why.querySelector("summary").focus({ preventScroll: true });
}
addEventListener("hashchange", explain);
explain();
