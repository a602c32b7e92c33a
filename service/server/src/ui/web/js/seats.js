// Which pages of this browser listen. A browser opens six connections to a server (HTTP/1.1) for all its pages together,
// and a stream takes one for as long as it lasts: with one for every page the seventh does not even load.
// Pages tell each other over a BroadcastChannel, which is there without TLS as well; locks are not.

/** Pages of one browser that listen at most: half of its connections, so that the other half fetches. */
export const SEATS = 3;

/** Calls `moved(true)` when this page may listen, `moved(false)` when it may no more: it has to be seen, and of those that are
 *  seen the ones used last listen. Every page knows of all others and ranks them alike, so nobody has to decide for all. */
export function seat(moved) {
  const me = `${Date.now().toString(36)}-${Math.random().toString(36).slice(2)}`;
  /** The other pages that are seen, and when each was used last. */
  const others = new Map();
  let channel = null, used = 0, mine = false;
  const tell = (what, more) => channel?.postMessage({ what, id: me, used, ...more });
  function settle() {
    const before = [...others].filter(([id, at]) => at > used || (at === used && id > me)).length, may = channel != null && before < SEATS;
    if (may !== mine) { mine = may; moved(mine); }
  }
  function heard({ data }) {
    if (data.what === "left") others.delete(data.id);
    else { others.set(data.id, data.used); if (data.ask) tell("seen"); }
    settle();
  }
  /** Asks the others anew: a page that crashed told nobody that it left. */
  function come() {
    channel ??= Object.assign(new BroadcastChannel("feedwright-seats"), { onmessage: heard });
    used = Date.now();
    others.clear();
    tell("seen", { ask: true });
    settle();
  }
  function leave() {
    if (!channel) return;
    tell("left");
    channel.close();
    channel = null;
    settle();
  }
  const look = () => { if (document.hidden) leave(); else come(); };
  document.addEventListener("visibilitychange", look);
  addEventListener("focus", () => { if (!document.hidden) come(); });
  addEventListener("pagehide", leave);
  // A page that comes back out of the browser's memory.
  addEventListener("pageshow", (event) => { if (event.persisted) look(); });
  look();
}
