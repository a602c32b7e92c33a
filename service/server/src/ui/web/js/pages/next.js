import { $, fill, html, put, trusted } from "../html.js";
import { icon } from "../icons.js";
import { shell } from "../shell.js";
import { empty, failure, notice, skeleton } from "../states.js";
import { ApiError, all, get, passing, segment, session, wholeFleet } from "../api.js";
import { num, percent, rounded, span, time, timeSeconds, unit } from "../format.js";
import { levelPercent, shownLevel } from "../wear.js";
import { keep, listen, opening } from "../live.js";
import { language, t, told } from "../text.js";

const asked = new URLSearchParams(location.search);
const MOST_OTHERS = 4, MOST_IDS = 5000;
/** Without a connection advice is asked for this often, ms, and other machines are looked at. */
const BEAT_MS = 20_000;
/** The other machines are all of them: read no more often than this, ms, whatever is told. */
const LEAST_LOOK_MS = 5000;
/** What may be another one by now: the advice, and that of the other machines. */
const due = { advice: false, others: false };
let advice = null, question = null, looked = 0, answered = 0, kept = null, fleet = [], skew = 0, known = { operations: [], tools: [], complete: true };
const now = () => Date.now() + skew;

/** The one instruction: a verb, and what it is about. */
function instruction(one) {
  if (one.action !== "run") return told("action", one.action, one.action);
  const override = percent(one.override_percent);
  const feed = one.feed, asked_ = one.reference_cycle;
  if (asked_) return asked_.feed_mm_min == null ? t("next.runReference") : t("next.runReferenceAt", { feed: unit(asked_.feed_mm_min, "mm/min") });
  if (feed.profile) return t("next.runProfile", { profile: feed.profile.id, version: feed.profile.version, override });
  if (feed.source === "programmed" && feed.feed_mm_min != null) return t("next.runFeed", { feed: unit(feed.feed_mm_min, "mm/min"), override });
  return t("next.runProgram", { override });
}
function toolLine(one) {
  const level = one.tool_state.level, left = one.tool_state.remaining, shown = level?.decides ? shownLevel((level.value - 1) * 100) : null;
  switch (one.tool_state.state) {
    case "worn": return ["act", t("next.toolWorn", { level: shown ?? "" })];
    case "broken_suspected": return ["act", t("next.toolBroken")];
    case "changed": return ["plan", t("next.toolChanged")];
    case "warning": return ["plan", left ? t("next.toolWarning", { count: rounded(left.cycles) }) : t("next.toolPlan")];
    case "good": return ["note", left ? t("next.toolGood", { count: rounded(left.cycles) }) : t("next.toolGoodEarly", { level: shown ?? "" })];
    case "learning": return ["note", t("next.toolLearning")];
    default: return ["note", t("next.toolUnknown")];
  }
}
const reasonText = (reason) => language === "en" ? sentence(reason.message) : told("reason", reason.code, sentence(reason.message));
const sentence = (text) => { const first = text.charAt(0).toUpperCase() + text.slice(1); return /[.!?]$/.test(first) ? first : `${first}.`; };
const ofTool = new Set(["good", "warning", "worn", "learning", "undercut", "conditions_changed", "level_outdated", "level_carried_over", "no_new_tool_baseline", "masked_by_control", "cycle_time_risen", "speed_changed", "level_unconfirmed", "cut_short", "clock_suspect", "being_counted", "clock_never_set", "no_cycles", "data_stale", "tool_unregistered"]);
function reasonLink(one, code) {
  if (ofTool.has(code)) return html`<a href="/tool?id=${segment(one.tool)}">${t("nav.tool")}</a>`;
  if (code.includes("profile")) return html`<a href="/profile?operation=${segment(one.operation)}">${t("nav.profile")}</a>`;
  return html`<a href="/settings#operations">${t("set.operations")}</a>`;
}
function evidence(one, code) {
  const level = one.tool_state.level;
  if (["good", "warning", "worn"].includes(code) && level) return t("next.evidenceLevel", { n: num(level.n), low: shownLevel((level.lowest - 1) * 100), high: shownLevel((level.highest - 1) * 100) });
  if (code === "data_stale" && one.data.age_ms != null) return t("next.evidenceAge", { age: span(one.data.age_ms) });
  return code;
}
/** What stops a machine holds until something newer says otherwise: nothing that ran out sets it going again. */
const stops = (one) => one.action !== "run";
function validity(one) {
  const from = Date.parse(one.issued_at), until = Date.parse(one.valid_until), left = until - now(), part = Math.max(0, Math.min(1, left / Math.max(1, until - from)));
  put($("#valid"), html`<svg viewBox="0 0 100 4" preserveAspectRatio="none" aria-hidden="true"><rect width="100" height="4" fill="var(--sunken)"/><rect width="${trusted((part * 100).toFixed(1))}" height="4" fill="var(--ink-2)"/></svg><p>${left > 0 ? html`<b>${t("next.validUntil", { time: time(until) })}</b>, ${t(stops(one) ? "next.leftStop" : "next.leftAfter", { left: span(left) })}` : html`<b>${t("next.ranOut", { time: time(until) })}</b>`}</p>`);
  // Long before it runs out, so that a machine that stands still has fresh advice as well.
  if (part < 0.5) soon();
  const over = left <= 0;
  if (over === ($("#rec-h").dataset.over === "true")) return;
  $("#card").classList.toggle("over", over && !stops(one));
  paintHead(over);
}
// After its time an advice to run is struck and replaced by the neutral one.
function paintHead(over) {
  const one = advice, [level, text] = toolLine(one), stop = stops(one);
  $("#rec-h").dataset.over = String(over);
  put($("#rec-h"), over && !stop ? html`<s>${instruction(one)}</s> ${t("next.noAdvice")}` : html`${stop ? html`<span class="act-ink">${icon("act", t("level.act"))}</span>` : ""}${instruction(one)}`);
  put($("#then"), html`<span class="${level === "act" ? "act-ink" : level === "plan" ? "plan-ink" : ""}">${icon(level, t(`level.${level}`))}</span><span>${over ? t(stop ? "next.stopHolds" : "next.askAgain") : text}</span>`);
}
function card() {
  const one = advice, limits = one.load_limits, feed = one.feed, process = one.process_advice;
  const settings = [
    [t("next.feed"), one.reference_cycle?.feed_mm_min != null ? html`${num(one.reference_cycle.feed_mm_min)} <span class="unit">mm/min</span>` : feed.profile ? html`<a href="/profile?id=${segment(feed.profile.id)}&amp;version=${feed.profile.version}">${feed.profile.id}</a> <span class="unit">${t("profile.version", { n: feed.profile.version })}</span>` : feed.feed_mm_min == null ? t("next.asProgram") : html`${num(feed.feed_mm_min)} <span class="unit">mm/min</span>`],
    [t("cycle.override"), html`${num(one.override_percent)} <span class="unit">%</span>`],
    [t("whatif.feed"), limits.feed_drive_load_set_percent == null ? html`<span class="faint">${t("none")}</span>` : html`${num(limits.feed_drive_load_set_percent)} <span class="unit">%</span>`],
    [t("whatif.spindle"), limits.spindle_load_set_percent == null ? html`<span class="faint">${t("none")}</span>` : html`${num(limits.spindle_load_set_percent)} <span class="unit">%</span>`],
    [t("next.machineRange"), html`${num(one.limits.override_min_percent)} ${t("to")} ${num(one.limits.override_max_percent)} <span class="unit">%</span>`],
  ];
  const last = fleet.find((item) => item.machine === one.machine)?.last_cycle;
  // Whoever stands on the button, by keys or with a screen reader, stands there afterwards too.
  const focused = document.activeElement?.closest("#card") ? document.activeElement.id : "";
  fill($("#card"), html`<p class="where"><b>${one.machine}</b><span>${one.operation}</span><span>${t("nav.tool")} <a href="/tool?id=${segment(one.tool)}">${one.tool}</a></span></p>
    <h1 id="rec-h"></h1><p class="then" id="then"></p><div class="valid" id="valid"></div>
    <dl class="settings">${settings.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>
    ${process?.turning?.next ? notice("", t("next.turning"), t("next.turningText", { speed: unit(process.turning.next.speed_m_min, "m/min", 0), feed: unit(process.turning.next.feed_mm_rev, "mm/rev", 3), minutes: unit(process.turning.next.interval_min, "min", 1) })) : ""}
    ${process?.plunge ? notice("", t("next.plunge"), process.plunge.feed_mm_min == null ? t("next.plungeNone") : t("next.plungeText", { feed: unit(process.plunge.feed_mm_min, "mm/min"), limit: told("bound", process.plunge.limit) })) : ""}
    <h2>${t("next.why")}</h2><ol class="reasons">${one.reasons.map((reason) => html`<li><span><span class="t">${reasonText(reason)}</span><span class="e">${evidence(one, reason.code)}</span></span>${reasonLink(one, reason.code)}</li>`)}</ol>
    <div class="rec-do"><button class="btn" id="anew">${t("next.again")}</button><a class="btn" href="/tool?id=${segment(one.tool)}">${t("tool.recordChange")}</a>${last ? html`<a class="btn" href="/cycle?machine=${segment(one.machine)}&amp;id=${segment(last.cycle_id)}">${t("tool.lastCycle")}</a>` : ""}<span class="given">${t("next.given", { time: timeSeconds(one.issued_at), quality: told("quality", one.data.quality) })}</span></div>`);
  paintHead(false);
  $("#card").classList.remove("over");
  validity(one);
  $("#anew").addEventListener("click", ask);
  if (focused) document.getElementById(focused)?.focus();
  put($("#json"), JSON.stringify(one, null, 1));
}
function others() {
  const first = fleet.filter((item) => item.machine !== advice?.machine && item.last_cycle).map((item) => ({ item, rank: { worn: 0, broken_suspected: 1, changed: 2, warning: 3, learning: 4 }[item.wear?.state] ?? 9 })).sort((a, b) => a.rank - b.rank).slice(0, MOST_OTHERS);
  put($("#others"), html`${first.map(({ item }) => { const state = item.wear?.state ?? "unknown", act = state === "worn" || state === "broken_suspected", value = levelPercent(item.wear), last = item.last_cycle;
    return html`<article class="panel mini ${act ? "act" : ""}"><p class="where"><b>${item.machine}</b><span>${t("nav.tool")} ${last.tool}</span></p><h2><span class="${act ? "act-ink" : state === "warning" || state === "changed" ? "plan-ink" : ""}">${icon(act ? "act" : state === "warning" || state === "changed" ? "plan" : state === "learning" ? "setup" : "note")}</span>${told("action", { worn: "change_tool", broken_suspected: "check_tool", changed: "confirm_conditions" }[state] ?? "run")}</h2><p>${value == null ? t(`toolstate.${state}`) : t("next.miniLevel", { level: shownLevel(value) })}</p><p class="faint small"><a href="/next?machine=${segment(item.machine)}&amp;operation=${segment(last.operation)}&amp;tool=${segment(last.tool)}">${t("next.show")}</a></p></article>`; })}`);
  $("#others").hidden = first.length === 0;
}
async function refresh() {
  // Of two questions under way the later one is what the picker says.
  question?.abort();
  const mine = question = new AbortController();
  let answer;
  try { answer = await get(`/v1/recommendations?machine=${segment(asked.get("machine"))}&operation=${segment(asked.get("operation"))}&tool=${segment(asked.get("tool"))}`, { signal: mine.signal }); } catch (error) { if (mine.signal.aborted) return; throw error; }
  if (mine !== question) return;
  advice = answer;
  answered = Date.now();
  skew = Date.parse(advice.issued_at) - Date.now();
  card();
  others();
}
/** Asks again when it is this page's turn; until the answer is there the button says so. */
function ask() {
  if (!kept) { location.reload(); return; }
  const again = $("#anew");
  if (again) { again.disabled = true; again.setAttribute("aria-busy", "true"); }
  due.advice = due.others = true;
  kept.nudge();
}
function soon() {
  if (due.advice || Date.now() - answered < BEAT_MS) return;
  due.advice = true;
  kept?.nudge();
}
/** Something else is asked for: nothing of what was shown is of it. */
function another() {
  advice = null;
  question?.abort();
  $("#card").classList.remove("over");
  fill($("#card"), skeleton(5));
  put($("#json"), "");
  ask();
}
/** What was refused, with the way to ask again. */
function refused(error) {
  put($("#json"), "");
  fill($("#card"), html`<h1>${t("nav.next")}</h1>${failure(error, t("error.load"))}<div class="rec-do"><button class="btn" id="anew">${t("next.again")}</button></div>`);
  $("#anew").addEventListener("click", ask);
}
/** What is due, and everything where nobody tells what happens. */
async function catchUp(heard) {
  const asks = due.advice || !heard || !advice, looks = !heard || (due.others && Date.now() - looked >= LEAST_LOOK_MS), later = due.others && !looks;
  Object.assign(due, { advice: false, others: later });
  try {
    if (asks) await refresh();
    if (looks) { looked = Date.now(); fleet = await wholeFleet(2); others(); }
  } catch (error) {
    Object.assign(due, { advice: asks, others: looks || later });
    if (error instanceof ApiError && !advice) refused(error);
    const again = $("#anew");
    if (again) { again.disabled = false; again.removeAttribute("aria-busy"); }
    throw error;
  }
}
function picker() {
  const options = (list, chosen) => { const all_ = list.includes(chosen) || !chosen ? list : [chosen, ...list]; return all_.map((id) => html`<option value="${id}" ${id === chosen ? html`selected` : ""}>${id}</option>`); };
  fill($("#picker"), html`<label for="p-machine">${t("col.machine")}</label><select id="p-machine">${options(fleet.map((item) => item.machine), asked.get("machine"))}</select><label for="p-operation">${t("col.operation")}</label><select id="p-operation">${options(known.operations, asked.get("operation"))}</select><label for="p-tool">${t("col.tool")}</label><select id="p-tool">${options(known.tools, asked.get("tool"))}</select>${known.complete ? "" : html`<p class="muted">${t("next.cut", { count: num(MOST_IDS) })}</p>`}`);
  $("#picker").onchange = (event) => {
    if (event.target.id === "p-machine") { // what the machine ran last is what it most likely runs next
      const last = fleet.find((item) => item.machine === event.target.value)?.last_cycle;
      if (last) { $("#p-operation").value = last.operation; $("#p-tool").value = last.tool; }
    }
    for (const name of ["machine", "operation", "tool"]) asked.set(name, $(`#p-${name}`).value);
    history.pushState(null, "", `/next?${asked}`);
    another();
  };
}
addEventListener("popstate", () => {
  const at = new URLSearchParams(location.search);
  if (!kept || !at.get("machine")) { location.reload(); return; }
  for (const name of ["machine", "operation", "tool"]) asked.set(name, at.get(name) ?? "");
  picker();
  another();
});
shell(t("nav.next"));
fill($("#main"), html`<div class="head"><div class="titles"><p class="crumbs"><a href="/">${t("nav.fleet")}</a> / ${t("nav.next")}</p></div><form class="tools" id="picker"></form></div><div class="rec-grid"><article class="panel rec" id="card" aria-label="${t("nav.next")}">${skeleton(5)}</article><div class="stack"><section id="others" class="others" aria-label="${t("next.others")}"></section><section class="panel"><header><h2>${t("next.asMes")}</h2></header><div class="body"><pre class="nc json" tabindex="0" role="region" aria-label="JSON" id="json"></pre></div></section></div></div>`);
await opening(async () => {
  const [, machines, operations, tools] = await Promise.all([session(), wholeFleet(2), all("/v1/operations", MOST_IDS), all("/v1/tools", MOST_IDS)]);
  fleet = machines;
  known = { operations: operations.items.map((one) => one.id), tools: tools.items.map((one) => one.id), complete: operations.complete && tools.complete };
  const newest = [...fleet].filter((item) => item.last_cycle).sort((a, b) => Date.parse(b.last_cycle.received_at) - Date.parse(a.last_cycle.received_at))[0];
  const from = fleet.find((item) => item.machine === asked.get("machine")) ?? newest;
  if (!from?.last_cycle && !(asked.get("machine") && asked.get("operation") && asked.get("tool"))) {
    fill($("#card"), empty(t("next.none"), t("next.noneText"), html`<a class="btn" href="/settings">${t("nav.settings")}</a>`, true));
    $("#others").hidden = true;
    put($("#json"), "{}");
  } else {
    if (!asked.get("machine")) asked.set("machine", from.machine);
    if (!asked.get("operation")) asked.set("operation", from.last_cycle.operation);
    if (!asked.get("tool")) asked.set("tool", from.last_cycle.tool);
    history.replaceState(null, "", `/next?${asked}`);
    picker();
    try { await refresh(); } catch (error) { if (!(error instanceof ApiError) || passing(error)) throw error; refused(error); }
    const anew = () => { due.advice = due.others = true; kept.nudge(); };
    const live = listen("", {
      // A cycle of another machine waits for the beat: a shop has one every second.
      cycle: (event) => { due.others = true; if (event.machine === asked.get("machine") || event.tool === asked.get("tool")) { due.advice = true; kept.nudge(); } },
      alarm: anew, changed: anew, gap: anew,
    });
    kept = keep(() => catchUp(live.heard()), BEAT_MS, { least: 1000, drawn: true });
    setInterval(() => { if (advice && $("#valid")) validity(advice); }, 1000);
  }
}, refused);
