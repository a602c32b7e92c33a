// Keeps a page fresh: listens to what happens (Server-Sent Events), asks again on a beat while it is looked at, and says
// when the server does not answer. Nothing here grows: an event is handed on and forgotten.
import { freshness } from "./shell.js";
import { icon } from "./icons.js";
import { $, element, fill, html } from "./html.js";
import { ApiError, passing, stillSignedIn } from "./api.js";
import { seat } from "./seats.js";
import { failure } from "./states.js";
import { time } from "./format.js";
import { t } from "./text.js";

const RETRY_MS = 5000;
/** A connection on which nothing came for so many heartbeats is dead, also where the browser has not noticed. */
const SILENT_BEATS = 2.5;
/** Everything the server may tell. */
const TOLD = ["state", "machine", "cycle", "alarm", "changed", "sample", "gap", "heartbeat"];
let since = null, listening = false;
function offline(is) {
  const shown = $("#offline");
  if (is === Boolean(shown)) return;
  if (!is) { since = null; shown.remove(); return; }
  since ??= Date.now();
  $("#main").prepend(element(html`<div class="notice plan" id="offline" role="status">${icon("silent")}<div><b>${t("offline.title", { time: time(since) })}</b><p>${t("offline.text")}</p></div></div>`));
}
/** Opens a page: what the server cannot do now is said, and tried again from the beginning; what it refuses is told by `refused`. */
export async function opening(work, refused) {
  for (;;) {
    try {
      await work();
      if ($("#live")?.dataset.state === "offline") freshness(listening ? "live" : "polled");
      offline(false);
      return;
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (!passing(error)) { offline(false); refused(error); return; }
      offline(true);
      freshness("offline");
      await new Promise((wake) => setTimeout(wake, RETRY_MS));
    }
  }
}

/** Calls `work` now and every `beat` ms while the page is visible; `nudge()` asks for it sooner, once in `least` ms.
 *  `drawn` where the page has read everything already: `work` comes on the next beat. */
export function keep(work, beat, { least = 2000, drawn = false } = {}) {
  let timer = 0, running = false, again = false, last = drawn ? Date.now() : 0, stopped = false;
  const plan = (ms) => { clearTimeout(timer); if (!stopped) timer = setTimeout(run, ms); };
  async function run() {
    if (running) { again = true; return; }
    if (document.hidden || stopped) return;
    running = true;
    try {
      await work();
      offline(false);
      freshness(listening ? "live" : "polled");
      last = Date.now();
      plan(again ? least : beat);
    } catch (error) {
      // A fault of the page's own is told where faults are told; the page goes on asking, and does not call itself fresh.
      if (!(error instanceof ApiError)) { freshness("connecting"); plan(beat); throw error; }
      if (passing(error)) { offline(true); freshness("offline"); plan(RETRY_MS); return; }
      // What is refused at first is all there is to show; later it leaves what is there.
      offline(false);
      if (last) { freshness("polled"); plan(beat * 4); } else fill($("#first") ?? $("#main"), failure(error, t("error.load")));
    } finally { running = false; again = false; }
  }
  document.addEventListener("visibilitychange", () => { if (!document.hidden) run(); });
  const first = drawn ? Promise.resolve() : run();
  if (drawn) plan(beat);
  return { first, nudge: () => { if (running) again = true; else plan(Math.max(0, least - (Date.now() - last))); }, stop: () => { stopped = true; clearTimeout(timer); } };
}

/** Hands on the events of `/v1/live` by name, each with its data; `query` as the address takes it. A page that nobody sees
 *  does not listen, nor do more pages of one browser than have a seat: `unheard` is called when it stops, and when it begins
 *  again `state` comes first. Whoever shows what events bring keeps it fresh by asking meanwhile: `heard()` says whether it has to. */
export function listen(query, handlers, unheard = () => {}) {
  let source = null, timer = 0, beat = 0, silent = 0, last = "";
  const later = () => { clearTimeout(timer); if (source) timer = setTimeout(probe, RETRY_MS); };
  // A connection that broke may come back by itself; until then it is asked whether there is a server, and a session.
  async function probe() {
    try {
      await stillSignedIn();
      offline(false);
      if (!listening) freshness("polled");
      if (!source) return;
      if (source.readyState === EventSource.CLOSED) open(); else if (source.readyState !== EventSource.OPEN) later();
    } catch (error) {
      later();
      if (!(error instanceof ApiError)) throw error;
      if (passing(error)) { offline(true); freshness("offline"); }
    }
  }
  function open() {
    // A connection that is made anew goes on where the one before it ended: what was told meanwhile comes, or a gap.
    const asked = new URLSearchParams(query);
    if (last) asked.set("after", last);
    const mine = source = new EventSource(`/v1/live${asked.size ? `?${asked}` : ""}`);
    const dead = () => { mine.close(); if (mine !== source) return; listening = false; freshness("connecting"); clearTimeout(timer); probe(); };
    const alive = () => { clearTimeout(silent); if (beat && mine === source) silent = setTimeout(dead, SILENT_BEATS * beat); };
    for (const name of TOLD) source.addEventListener(name, (event) => { if (event.lastEventId) last = event.lastEventId; if (name === "state") beat = JSON.parse(event.data).heartbeat_ms ?? 0; alive(); });
    source.addEventListener("open", () => { alive(); listening = true; clearTimeout(timer); offline(false); freshness("live"); });
    source.addEventListener("error", () => {
      if (mine !== source) return;
      if (listening) { listening = false; freshness("connecting"); clearTimeout(timer); timer = setTimeout(probe, 500); } else later();
    });
    for (const [name, handle] of Object.entries(handlers)) source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  }
  function close() {
    clearTimeout(timer);
    clearTimeout(silent);
    source.close();
    source = null;
    listening = false;
    if (!$("#offline")) freshness(document.hidden ? "connecting" : "polled");
    unheard();
  }
  seat((mine) => { if (mine) open(); else close(); });
  return { heard: () => listening };
}
