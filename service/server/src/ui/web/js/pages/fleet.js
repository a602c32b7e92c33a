import { $, $$, element, fill, html, put } from "../html.js";
import { icon } from "../icons.js";
import { action, shell } from "../shell.js";
import { empty, failure, skeleton } from "../states.js";
import { get, segment, session } from "../api.js";
import { age, num, rounded, span, time } from "../format.js";
import { cyclesLeft, flag, isHidden, leftCell, levelPercent, shownLevel, sparkline, todo, wearBar, wearCell, wearClass } from "../wear.js";
import { keep, listen } from "../live.js";
import { t } from "../text.js";

const BEAT_MS = 5000;
/** A machine runs while its next cycle is not later than this many usual distances, within these bounds, ms. */
const CADENCES = 3, SHORTEST_RUN_MS = 60_000, LONGEST_RUN_MS = 15 * 60_000;
const MOST_MACHINES = 5000;
const wall = document.documentElement.dataset.view === "wall";
const signs = { drilling: "drilling", running: "running", idle: "idle", silent: "silent", none: "setup" };
const states = ["drilling", "running", "idle", "silent", "none"];
const rank = { act: 0, plan: 1, note: 2 };
const natural = new Intl.Collator(undefined, { numeric: true }).compare;

// What is known: rows by machine, the server's clock against ours, and how the page is looked at.
let rows = [], skew = 0, sortKey = "attention", descending = false, filter = "all", wanted = "";
const nodes = new Map();
/** Machines whose stream has a cycle under way. */
const drilling = new Set();

function judge(item, stale) {
  const last = item.last_cycle;
  const since = last ? Date.now() + skew - Date.parse(last.received_at) : null;
  const runs = Math.min(LONGEST_RUN_MS, Math.max(SHORTEST_RUN_MS, CADENCES * (item.cadence_ms ?? 0)));
  const silent = last && (since > stale || item.alarms.some((alarm) => alarm.kind === "machine_silent"));
  const state = drilling.has(item.machine) ? "drilling" : !last ? "none" : silent ? "silent" : since <= runs ? "running" : "idle";
  return { ...item, since, state, todo: todo(item.alarms, item.wear, { silentFor: silent ? span(since) : null, tool: last?.tool }) ?? (last ? null : { level: "note", text: t("todo.first"), more: 0 }), left: cyclesLeft(item.wear, silent), level: levelPercent(item.wear) };
}
let stale = 0;
async function load() {
  const items = [];
  let cursor = null;
  do {
    const page = await get(`/v1/fleet?limit=500${cursor ? `&cursor=${segment(cursor)}` : ""}`);
    skew = Date.parse(page.now) - Date.now();
    stale = page.stale_after_ms;
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor && items.length < MOST_MACHINES);
  rows = items.map((item) => judge(item, stale));
}
const big = 1e15;
const orders = {
  attention: (a, b) => (rank[a.todo?.level] ?? 3) - (rank[b.todo?.level] ?? 3) || (b.level ?? -big) - (a.level ?? -big) || natural(a.machine, b.machine),
  name: (a, b) => natural(a.machine, b.machine),
  operation: (a, b) => natural(a.last_cycle?.operation_name ?? a.last_cycle?.operation ?? "\uffff", b.last_cycle?.operation_name ?? b.last_cycle?.operation ?? "\uffff"),
  wear: (a, b) => (a.level ?? -big) - (b.level ?? -big),
  left: (a, b) => (a.left.count ?? big) - (b.left.count ?? big),
  time: (a, b) => (a.last_cycle?.duration_ms ?? big) - (b.last_cycle?.duration_ms ?? big),
  energy: (a, b) => (a.last_cycle?.energy_joules ?? big) - (b.last_cycle?.energy_joules ?? big),
  last: (a, b) => (a.since ?? big) - (b.since ?? big),
};
const columns = [["state", null], ["machine", "name"], ["operation", "operation"], ["tool", null], ["wear", "wear"], ["left", "left", "num"], ["spark", null], ["time", "time", "num"], ["energy", "energy", "num"], ["last", "last"], ["todo", "attention"]];

const stateCell = (row) => html`<span class="state ${row.state} ${row.todo?.level === "act" ? "act" : ""}">${icon(row.todo?.level === "act" ? "act" : signs[row.state])}${t(`state.${row.state}`)}</span>`;
/** An id that is cut short, whole, and the name beside it. */
const titled = (id, name) => name && name !== id ? `${id}, ${name}` : id;
function cells(row) {
  const last = row.last_cycle;
  return {
    "c-state": stateCell(row),
    "c-name": html`<a href="${last ? `/cycle?machine=${segment(row.machine)}` : `/settings?machine=${segment(row.machine)}`}" title="${titled(row.machine, row.name)}">${row.machine}</a>`,
    "c-op": last ? html`<span title="${titled(last.operation, last.operation_name)}">${last.operation_name ?? last.operation}</span>` : "",
    "c-tool": last ? html`<a href="/tool?id=${segment(last.tool)}" title="${titled(last.tool, last.tool_name)}">${last.tool}</a>` : "",
    "c-wear": last ? wearCell(row.wear) : "",
    "c-left": last ? leftCell(row.left) : "",
    "c-spark": sparkline(row.energy_ratios),
    "c-dur": last?.duration_ms == null ? "" : num(last.duration_ms / 1000, 2),
    "c-energy": last?.energy_joules == null ? "" : num(last.energy_joules),
    "c-ago": row.since == null ? "" : age(row.since, last.received_at),
    "c-alarm": flag(row.todo),
  };
}
const numeric = new Set(["c-left", "c-dur", "c-energy"]);
function makeRow(row) {
  const node = element(html`<table><tbody><tr>${Object.keys(cells(row)).map((name) => name === "c-name" ? html`<th scope="row" class="c-name"></th>` : html`<td class="${name} ${numeric.has(name) ? "num" : ""}"></td>`)}</tr></tbody></table>`).querySelector("tr");
  const parts = Object.fromEntries([...node.children].map((cell) => [cell.classList[0], cell]));
  return { node, parts };
}
function paint(row) {
  let known = nodes.get(row.machine);
  if (!known) { known = makeRow(row); nodes.set(row.machine, known); }
  for (const [name, content] of Object.entries(cells(row))) put(known.parts[name], content);
  known.node.classList.toggle("old", row.state === "silent");
  return known.node;
}
let order = [], attention = "";
const urgency = () => rows.filter((row) => row.todo?.level === "act" || row.todo?.level === "plan").map((row) => `${row.machine}:${row.alarms.at(-1)?.id ?? row.todo.level}`).sort().join();
function sortRows() {
  order = [...rows].sort((a, b) => (descending ? -1 : 1) * orders[sortKey](a, b) || natural(a.machine, b.machine)).map((row) => row.machine);
  attention = urgency();
  for (const header of $$("thead th[data-sort]")) header.setAttribute("aria-sort", header.dataset.sort === sortKey ? (descending ? "descending" : "ascending") : "none");
  $("#sort").value = [...$("#sort").options].some((option) => option.value === sortKey) ? sortKey : "";
}
function table() {
  const known = new Map(rows.map((row) => [row.machine, row]));
  const missing = rows.some((row) => !order.includes(row.machine)) || order.length !== rows.length;
  // Rows re-sort on demand, and where a new alarm has come.
  if (missing || (sortKey === "attention" && urgency() !== attention)) sortRows();
  const wants = wanted.toLowerCase();
  const shown = order.map((machine) => known.get(machine)).filter((row) => row && (filter === "all" || row.state === filter) && (!wants || [row.machine, row.name, row.last_cycle?.tool, row.last_cycle?.tool_name, row.last_cycle?.operation, row.last_cycle?.operation_name].join(" ").toLowerCase().includes(wants)));
  const body = $("#rows");
  shown.forEach((row, i) => { const node = paint(row); if (body.children[i] !== node) body.insertBefore(node, body.children[i] ?? null); });
  while (body.children.length > shown.length) body.lastElementChild.remove();
  for (const machine of nodes.keys()) if (!known.has(machine)) nodes.delete(machine);
  $("#no-match").hidden = shown.length > 0 || rows.length === 0;
  summary();
}
const count = (state) => rows.filter((row) => row.state === state).length;
/** How many machines need somebody now, or today. */
function urgent() {
  const acts = rows.filter((row) => row.todo?.level === "act").length, plans = rows.filter((row) => row.todo?.level === "plan").length;
  put($("#sum"), html`${acts ? html`<span class="flag act">${icon("act")}${t("fleet.act", { count: acts })}</span>` : ""}${plans ? html`<span class="flag plan">${icon("plan")}${t("fleet.plan", { count: plans })}</span>` : ""}${acts + plans ? "" : html`<span class="muted">${t("fleet.calm")}</span>`}`);
}
function summary() {
  urgent();
  for (const chip of $$("#chips button")) { chip.setAttribute("aria-pressed", String(chip.value === filter)); put($("b", chip), num(chip.value === "all" ? rows.length : count(chip.value))); }
}
function frame() {
  fill($("#main"), html`<div class="head">
    <div class="titles"><h1>${t("fleet.title")}</h1><p class="fleet-sum" id="sum" role="status"></p></div>
    <div class="tools">
      <label class="sr" for="find">${t("fleet.findLabel")}</label><input type="search" id="find" autocomplete="off" placeholder="${t("fleet.find")}">
      <label class="sr" for="sort">${t("fleet.sort")}</label><select id="sort"><option value="attention">${t("fleet.attention")}</option><option value="left">${t("col.left")}</option><option value="name">${t("col.machine")}</option><option value="last">${t("col.last")}</option></select>
      <div class="seg" role="group" aria-label="${t("fleet.view")}"><a href="/" aria-current="page">${t("fleet.table")}</a><a href="/?view=wall">${t("fleet.wall")}</a></div>
    </div></div>
    <div class="chips" id="chips" role="group" aria-label="${t("fleet.filter")}"><button value="all">${t("fleet.all")} <b></b></button>${states.map((state) => html`<button value="${state}">${icon(signs[state])}${t(`state.${state}`)} <b></b></button>`)}</div>
    <section class="panel fleet" aria-label="${t("fleet.machines")}">
      <table><thead><tr>${columns.map(([name, sort, kind]) => html`<th scope="col" class="${kind ?? ""} h-${name}" ${sort ? html`data-sort="${sort}"` : ""}>${sort ? html`<button class="sort">${t(`col.${name}`)}</button>` : t(`col.${name}`)}</th>`)}</tr></thead><tbody id="rows"></tbody></table>
      <div id="first">${skeleton(6)}</div><p id="no-match" class="muted pad" hidden>${t("fleet.noMatch")}</p>
    </section>
    <p class="foot">${t("fleet.foot")}</p>`);
  $("#sort").addEventListener("change", (event) => { sortKey = event.target.value; descending = false; sortRows(); table(); });
  $("#find").addEventListener("input", (event) => { wanted = event.target.value.trim(); table(); });
  $("#chips").addEventListener("click", (event) => { const chip = event.target.closest("button"); if (chip) { filter = chip.value; table(); } });
  $("thead").addEventListener("click", (event) => {
    const header = event.target.closest("th[data-sort]");
    if (!header) return;
    descending = sortKey === header.dataset.sort ? !descending : header.dataset.sort === "wear";
    sortKey = header.dataset.sort;
    sortRows();
    table();
  });
}
function nothing(who) {
  fill($("#main"), html`<div class="head"><div class="titles"><h1>${t("fleet.title")}</h1></div></div><section class="panel body">${empty(t("fleet.empty"), t("fleet.emptyText"), html`${action(who, "PUT /v1/machines/{machine}", t("fleet.emptyAction"), { id: "add", primary: true })}<a class="btn" href="/docs/">${t("fleet.emptyRequest")}</a>`)}</section>`);
  $("#add").addEventListener("click", () => { if ($("#add").getAttribute("aria-disabled") !== "true") location.assign("/settings#machines"); });
}

// Within a line only the first letter is lowered: German nouns keep theirs.
const lowered = (text) => text.charAt(0).toLowerCase() + text.slice(1);
// The wall is read from eight metres: machines never change their place, and only what is abnormal has a border.
function wallFrame() {
  document.body.className = "wall";
  document.title = `${t("fleet.title")} \u2013 Feedwright`;
  fill($("#main"), html`<header class="wall-head"><h1>${t("fleet.wallTitle")}</h1><p class="fleet-sum" id="sum" role="status"></p><div class="wall-counts" id="counts"></div><span class="wall-time"><span class="live" id="live" role="status" data-state="polled"><span class="dot"></span><span class="live-text"></span></span><b id="clock"></b><a class="btn quiet" href="/">${t("wall.leave")}</a></span></header>
    <section class="wall-grid" id="grid" aria-label="${t("fleet.machines")}"></section><p class="wall-foot">${t("wall.foot")}</p>`);
}
const line = (row) => row.todo && row.todo.level !== "note" ? row.todo.text : row.left.count == null ? (row.todo?.text ?? row.left.text) : t("left.cycles", { count: rounded(row.left.count) });
function tile(row) {
  const warm = row.todo?.level === "act" || row.todo?.level === "plan" ? row.todo.level : "";
  const sign = warm || signs[row.state];
  return html`<header>${icon(sign, warm ? t(`level.${warm}`) : t(`state.${row.state}`))}<h2 title="${row.machine}">${row.machine}</h2><span class="st">${t(`state.${row.state}`)}</span></header>
    ${row.level == null ? html`<p class="big faint">${isHidden(row.wear) ? t("wear.hidden") : row.last_cycle ? t("wall.noBaseline") : t("wall.noCycle")}</p>` : html`<p class="big">${shownLevel(row.level).slice(0, -2)}<small>\u202f%</small></p><span class="wear ${wearClass(row.wear)}">${wearBar(row.wear, { width: 190, height: 9 })}</span>`}
    <p class="line">${line(row)}</p>`;
}
function wallPaint() {
  const grid = $("#grid");
  for (const row of [...rows].sort((a, b) => natural(a.machine, b.machine))) {
    let node = nodes.get(row.machine);
    if (!node) { node = document.createElement("article"); nodes.set(row.machine, node); }
    node.className = `tile ${row.todo && row.todo.level !== "note" ? row.todo.level : ""} ${row.state}`;
    put(node, tile(row));
  }
  const known = new Set(rows.map((row) => row.machine));
  for (const [machine, node] of nodes) if (!known.has(machine)) { node.remove(); nodes.delete(machine); }
  [...nodes.keys()].sort(natural).forEach((machine, i) => { const node = nodes.get(machine); if (grid.children[i] !== node) grid.insertBefore(node, grid.children[i] ?? null); });
  urgent();
  put($("#counts"), html`${states.map((state) => html`<span class="state ${state}">${icon(signs[state])}<b>${num(count(state))}</b> ${lowered(t(`state.${state}`))}</span>`)}`);
  put($("#clock"), time(Date.now()));
}

if (wall) wallFrame(); else { shell(t("fleet.title")); frame(); }
let begun = false;
try {
  const kept = keep(async () => {
    const who = await session();
    await load();
    if (rows.length === 0) { begun = false; nothing(who); return; }
    if (!begun) { if (!wall && !$("#rows")) frame(); $("#first")?.remove(); begun = true; }
    if (wall) wallPaint(); else table();
  }, BEAT_MS);
  await kept.first;
  const moved = (event) => { if (event.state === "running") drilling.add(event.machine); else drilling.delete(event.machine); };
  listen("", { state: (event) => { drilling.clear(); event.machines.forEach(moved); }, machine: moved, cycle: kept.nudge, alarm: kept.nudge, changed: kept.nudge, gap: kept.nudge }, () => drilling.clear());
} catch (error) { fill($("#first") ?? $("#main"), failure(error, t("error.load"))); }
// Ages move on between two answers.
setInterval(() => {
  if (document.hidden || !begun) return;
  rows = rows.map((row) => judge(row, stale));
  if (wall) wallPaint(); else table();
}, 1000);
