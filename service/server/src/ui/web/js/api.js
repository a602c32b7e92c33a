// The API with the session's cookie. Every failure is an ApiError with what the server said, in its own words.

export class ApiError extends Error {
  constructor(status, problem) {
    super(problem.detail || problem.title || `HTTP ${status}`);
    Object.assign(this, { status, code: problem.code || "unknown", errors: problem.errors || [], requestId: problem.request_id, retryAfter: problem.retryAfter });
  }
}

/** What the server cannot do now, and can do later. */
export const passing = (error) => error.code === "offline" || error.status >= 500 || error.status === 429;

/** Nobody is signed in: on to the sign-in, and back again from there. The page is left, so nothing of it goes on. */
const signInFrom = () => { location.replace(`/sign-in?next=${encodeURIComponent(location.pathname + location.search + location.hash)}`); return new Promise(() => {}); };
let entered = false, again = null;
/** The session ended while the page was at work: whoever signs in again goes on where they were, with what they entered. */
const signInAgain = () => again ??= import("./sign-in-again.js").then((dialog) => dialog.signInAgain()).finally(() => { again = null; });

/** An answer has begun after so long, ms, or there is none: sockets stay open where the radio fades. What changes something may wait
 *  for a commit. Once it has begun, nothing came of it for so long: however long it takes, a slow link brings it. */
const READ_MS = 30_000, CHANGE_MS = 60_000, QUIET_MS = 30_000;
const noAnswer = () => new ApiError(0, { code: "offline", detail: "no answer" });

let skew = 0;
/** The time by the server's clock, as its newest answer told it, to a second: ages of what it stored are by that clock. */
export const serverNow = () => Date.now() + skew;

/** Asks; gives `{ body, etag }`. */
export async function ask(method, path, { body, signal, etag, headers = {}, text = false } = {}) {
  const late = new AbortController(), allowed = method === "GET" ? READ_MS : CHANGE_MS;
  const init = { method, signal: signal ? AbortSignal.any([signal, late.signal]) : late.signal, credentials: "same-origin", headers: { accept: text ? "*/*" : "application/json", "x-feedwright-page": "1", ...headers } };
  if (body !== undefined) { init.body = JSON.stringify(body); init.headers["content-type"] = "application/json"; }
  if (etag) init.headers["if-match"] = etag;
  let answer, timer = 0;
  const wait = (ms) => { clearTimeout(timer); timer = setTimeout(() => late.abort(), ms); };
  /** The text of what was answered. */
  const whole = async () => {
    wait(QUIET_MS);
    const heard = new TransformStream({ transform: (part, on) => { wait(QUIET_MS); on.enqueue(part); } });
    try { return answer.body ? await new Response(answer.body.pipeThrough(heard)).text() : ""; } finally { clearTimeout(timer); }
  };
  wait(allowed);
  /** Whoever asked may want it no more; otherwise it did not come. */
  const broken = (error) => { if (error.name === "AbortError" && signal?.aborted) throw error; throw noAnswer(); };
  try { answer = await fetch(path, init); } catch (error) { return broken(error); } finally { clearTimeout(timer); }
  if (!answer.ok) {
    let problem = {};
    try { problem = JSON.parse(await whole()); } catch { /* not ours: the status has to do */ }
    problem.request_id ||= answer.headers.get("x-request-id");
    problem.retryAfter = answer.headers.get("retry-after");
    if (answer.status === 401 && document.body.dataset.page !== "sign-in" && path !== "/v1/session") {
      if (!entered) await signInFrom();
      await signInAgain();
      return ask(method, path, { body, signal, etag, headers, text });
    }
    throw new ApiError(answer.status, problem);
  }
  let content = null;
  try { content = await whole(); } catch (error) { return broken(error); }
  // What is no JSON is not ours, whatever its status: a proxy that says it is back in a minute.
  if (!text) try { content = answer.status === 204 ? null : JSON.parse(content); } catch { throw noAnswer(); }
  const at = Date.parse(answer.headers.get("date"));
  if (at) skew = at - Date.now();
  return { body: content, etag: answer.headers.get("etag"), status: answer.status };
}
export const get = async (path, options) => (await ask("GET", path, options)).body;
export const post = async (path, body, options) => (await ask("POST", path, { body, ...options })).body;

/** Every row of a list, at most `most`, `size` at a time. */
export async function all(path, most = 5000, { size = 1000, ...options } = {}) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(`${path}${path.includes("?") ? "&" : "?"}limit=${size}${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`, options);
    items.push(...page.items);
    cursor = page.next_cursor;
    if (items.length >= most) return { items: items.slice(0, most), complete: !cursor };
  } while (cursor);
  return { items, complete: true };
}
/** Every machine as the fleet has it, with so many of its last cycles. */
export const wholeFleet = async (recent) => (await all(`/v1/fleet?recent=${recent}`, 5000, { size: 500 })).items;

let known = null;
/** A session that is to last longer than this from now is that of a screen, ms: others end after 12 hours. */
const SHIFT_MS = 12 * 3_600_000;
/** Whether who signs in again is to stay signed in as long as who was signed in before: a screen on the wall. */
export let lasting = document.documentElement.dataset.view === "wall";
/** Who is signed in, and what they may do; the frame hears of it by the event `session`. */
export const session = () => known ||= get("/v1/session").then((who) => { entered = true; lasting ||= Date.parse(who.expires_at) - Date.now() > 2 * SHIFT_MS; dispatchEvent(new CustomEvent("session", { detail: who })); return who; }, (error) => { known = null; if (error.status === 401) return signInFrom(); throw error; });
/** Somebody else may have signed in again: what they may do is theirs. */
addEventListener("session", ({ detail: who }) => { known = Promise.resolve(who); });
/** Asks whether the session goes on; where it does not, whoever looks is asked to sign in again. */
export const stillSignedIn = async () => { try { await get("/v1/session"); } catch (error) { if (error.status !== 401) throw error; await signInAgain(); } };
/** Whether the session's role may use a route, as in `PUT /v1/tools/{tool}`: the server's table says so. */
export const may = (who, route) => who.may.includes(route);

/** A computation that has not been heard of for so long, ms, is given up; until then it is asked for again after so long. */
const UNHEARD_MS = 120_000, ASK_AGAIN_MS = 2000;

/** A long computation answers 202 with a job: waits for it, and gives what it found. */
export async function computed(path, body, { signal, progress } = {}) {
  const answer = await ask("POST", path, { body, signal });
  if (answer.status !== 202) return answer.body;
  // Whoever does not want it any more does not keep the server at it; what has ended is left alone.
  const cancel = () => { fetch(`/v1/jobs/${answer.body.id}`, { method: "DELETE", keepalive: true, headers: { "x-feedwright-page": "1" } }).catch(() => {}); };
  signal?.addEventListener("abort", cancel, { once: true });
  let heard = Date.now();
  for (;;) {
    signal?.throwIfAborted();
    let job;
    try { job = await get(`/v1/jobs/${answer.body.id}`, { signal }); } catch (error) {
      // The server goes on computing, whether or not it is heard for a while.
      if (!(error instanceof ApiError) || !passing(error) || Date.now() - heard > UNHEARD_MS) throw error;
      await new Promise((wake) => setTimeout(wake, ASK_AGAIN_MS));
      continue;
    }
    heard = Date.now();
    if (["done", "failed", "cancelled"].includes(job.state)) {
      signal?.removeEventListener("abort", cancel);
      if (job.state === "done") return job.result;
      throw new ApiError(500, { code: job.state, detail: job.state });
    }
    progress?.(job);
    await new Promise((wake) => setTimeout(wake, 300));
  }
}
export const segment = encodeURIComponent;
