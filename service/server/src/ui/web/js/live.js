// Keeps a page fresh: listens to what happens (Server-Sent Events), asks again on a beat while it is looked at, and says
// when the server does not answer. Nothing here grows: an event is handed on and forgotten.
import { freshness } from "./shell.js";
import { icon } from "./icons.js";
import { element, html, $ } from "./html.js";
import { session } from "./api.js";
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
      // What the server refuses is told by the page; what it cannot do now is tried again.
      if (error.code === "offline" || error.status >= 500) { offline(true); freshness("offline"); plan(RETRY_MS); } else throw error;
    } finally { running = false; again = false; }
  }
  document.addEventListener("visibilitychange", () => { if (!document.hidden) run(); });
  const first = run();
  return { first, nudge: () => { if (running) again = true; else plan(Math.max(0, least - (Date.now() - last))); }, stop: () => { stopped = true; clearTimeout(timer); } };
}

/** Hands on the events of `/v1/live` by name, each with its data; `query` as the address takes it. */
export function listen(query, handlers) {
  let source = null, timer = 0;
  const open = () => {
    source = new EventSource(`/v1/live${query ? `?${query}` : ""}`);
    source.addEventListener("open", () => { listening = true; freshness("live"); });
    source.addEventListener("error", () => {
      listening = false;
      freshness($("#offline") ? "offline" : "polled");
      // A browser gives up for good where the answer was an error: too many readers, or the session is over.
      if (source.readyState === EventSource.CLOSED) { clearTimeout(timer); timer = setTimeout(() => { session().then(open, () => {}); }, RETRY_MS * 2); }
    });
    for (const [name, handle] of Object.entries(handlers)) source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  };
  open();
  addEventListener("pagehide", () => { clearTimeout(timer); source.close(); });
  return { close: () => { clearTimeout(timer); source.close(); listening = false; } };
}
