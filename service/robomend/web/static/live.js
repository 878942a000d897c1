// The event stream: it tells which parts to fetch, and the page tells how it is. What may be old is shown as old.
import { passedMs } from "./clock.js";
import { refresh, refreshFor, spend, whenLost } from "./parts.js";

const KINDS = ["observations", "diagnosis", "repair", "configuration", "action", "board", "robot", "model", "batch", "drill", "moment", "stop"];
const AGAIN_MS = 2000; // between two tries
const HIDDEN_MS = 20000; // a page that nobody sees holds no connection: browsers have six for a host
const FRAME_BYTES = 60; // around the data of an event
const SETTLES_MS = 1500; // what an event tells of may show a moment later

export class Live {
  constructor(address, pingS) {
    this.address = address;
    this.silentMs = (2 * pingS + 5) * 1000;
    this.sign = document.getElementById("live");
    this.lostAt = null;
  }

  start() {
    whenLost((why) => this.lost(why));
    this.open();
    setInterval(() => this.watch(), 1000);
    document.addEventListener("visibilitychange", () => {
      clearTimeout(this.hiding);
      if (document.hidden) this.hiding = setTimeout(() => this.pause(), HIDDEN_MS);
      else if (!this.source) this.open();
    });
    addEventListener("pagehide", () => this.source?.close());
    addEventListener("pageshow", (event) => { if (event.persisted) this.open(); });
  }

  open() {
    this.source?.close();
    this.heardAt = passedMs();
    const source = this.source = new EventSource(this.address);
    source.onopen = () => { this.heard(); refresh("all"); };
    source.onerror = () => {
      this.lost("connection lost");
      if (source.readyState === EventSource.CLOSED) this.again();
    };
    source.addEventListener("ping", () => this.heard());
    source.addEventListener("gap", () => { this.heard(); refresh("all"); });
    for (const kind of KINDS) {
      source.addEventListener(kind, (event) => {
        this.heard();
        spend(event.data.length + FRAME_BYTES);
        refreshFor(kind);
        clearTimeout(this[kind]);
        this[kind] = setTimeout(() => refreshFor(kind), SETTLES_MS);
      });
    }
  }

  again() {
    clearTimeout(this.retry);
    this.retry = setTimeout(() => { if (!document.hidden) this.open(); }, AGAIN_MS);
  }

  pause() {
    this.source?.close();
    this.source = null;
    this.show("none", "paused while hidden");
  }

  heard() {
    this.heardAt = passedMs();
    this.lostAt = null;
    document.body.classList.remove("stale");
    this.show("live", document.body.dataset.live);
  }

  lost(why, sinceMs = passedMs()) {
    this.lostAt ??= sinceMs;
    this.why = why;
    document.body.classList.add("stale");
    this.watch();
  }

  watch() {
    if (this.source && this.lostAt === null && passedMs() - this.heardAt > this.silentMs) {
      this.lost("nothing is heard", this.heardAt); // a connection may die without a word, and did so since then
      this.open();
    }
    if (this.lostAt === null) return;
    const seconds = Math.round((passedMs() - this.lostAt) / 1000);
    this.show("lost", `${this.why}: shown is how it was ${seconds} s ago or earlier`);
  }

  show(state, text) {
    if (this.sign.dataset.state !== state) this.sign.dataset.state = state;
    this.sign.hidden = false;
    // Screen readers are told of a change of state, not of each second.
    this.sign.setAttribute("aria-live", state === "lost" && this.sign.dataset.told === "lost" ? "off" : "polite");
    this.sign.dataset.told = state;
    if (this.sign.textContent !== text) this.sign.textContent = text;
  }
}
