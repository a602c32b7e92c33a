// Keeps a page fresh: listens to what happens (Server-Sent Events), asks again on a beat while it is looked at, and says
// when the server does not answer. Nothing here grows: an event is handed on and forgotten.
import { freshness } from "./shell.js";
import { icon } from "./icons.js";
import { element, html, $ } from "./html.js";
import { ApiError, stillSignedIn } from "./api.js";
import { time } from "./format.js";
import { t } from "./text.js";

const RETRY_MS = 5000;
let since = null, listening = false;
function offline(is) {
  const shown = $("#offline");
  if (is === Boolean(shown)) return;
  if (!is) { since = null; shown.remove(); return; }
  since ??= Date.now();
  $("#main").prepend(element(html`<div class="notice plan" id="offline" role="status">${icon("silent")}<div><b>${t("offline.title", { time: time(since) })}</b><p>${t("offline.text")}</p></div></div>`));
}

/** Calls `work` now and every `beat` ms while the page is visible; `nudge()` asks for it sooner, once in `least` ms. */
export function keep(work, beat, least = 2000) {
  let timer = 0, running = false, again = false, last = 0, stopped = false;
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
      if (!(error instanceof ApiError)) throw error;
      // What the server cannot do now is tried again; what it refuses at first is told by the page.
      if (error.code === "offline" || error.status >= 500) { offline(true); freshness("offline"); plan(RETRY_MS); } else if (last) { freshness("polled"); plan(beat * 4); } else throw error;
    } finally { running = false; again = false; }
  }
  document.addEventListener("visibilitychange", () => { if (!document.hidden) run(); });
  const first = run();
  return { first, nudge: () => { if (running) again = true; else plan(Math.max(0, least - (Date.now() - last))); }, stop: () => { stopped = true; clearTimeout(timer); } };
}

/** Hands on the events of `/v1/live` by name, each with its data; `query` as the address takes it. */
export function listen(query, handlers) {
  let source = null, timer = 0, closed = false;
  const later = () => { clearTimeout(timer); if (!closed) timer = setTimeout(probe, RETRY_MS); };
  // A connection that broke may come back by itself; until then it is asked whether there is a server, and a session.
  async function probe() {
    try {
      await stillSignedIn();
      offline(false);
      if (!listening) freshness("polled");
      if (source.readyState === EventSource.CLOSED) open(); else if (source.readyState !== EventSource.OPEN) later();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      offline(true);
      freshness("offline");
      later();
    }
  }
  function open() {
    if (closed) return;
    source = new EventSource(`/v1/live${query ? `?${query}` : ""}`);
    source.addEventListener("open", () => { listening = true; clearTimeout(timer); offline(false); freshness("live"); });
    source.addEventListener("error", () => {
      if (listening) { listening = false; freshness("connecting"); clearTimeout(timer); timer = setTimeout(probe, 500); } else later();
    });
    for (const [name, handle] of Object.entries(handlers)) source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  }
  const close = () => { closed = true; clearTimeout(timer); source.close(); listening = false; };
  open();
  addEventListener("pagehide", close);
  // A page that comes back out of the browser's memory listens again.
  addEventListener("pageshow", (event) => { if (event.persisted && closed) { closed = false; open(); } });
  return { close };
}
