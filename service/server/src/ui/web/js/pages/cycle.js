import { $, $$, element, fill, html, put, trusted } from "../html.js";
import { icon } from "../icons.js";
import { shell } from "../shell.js";
import { empty, failure, notice, skeleton } from "../states.js";
import { ApiError, get, may, post, segment, session, wholeFleet } from "../api.js";
import { NB, dayMonth, moment, num, signed, time, unit } from "../format.js";
import { FONT, X, Y, chart, clip, dpr, halo, limit, line, nice, phone, ready, splits, token } from "../charts.js";
import { Track, forward } from "../track.js";
import { cycleLive } from "../cycle-live.js";
import { opening } from "../live.js";
import { entered, numeric, written } from "../fields.js";
import { t, told } from "../text.js";

/** Refusals of a cycle whose samples are not there any more. */
const GONE = new Set(["samples_dropped", "samples_lost"]);

const asked = new URLSearchParams(location.search);
const RECENT = 60, APPROACH_MM = -1.2, APPROACH_S = 0.6, KEYS = 40;
const cyclePath = (machine, id) => `/v1/machines/${segment(machine)}/cycles/${segment(id)}`;

/** What can be shown, in its order; a row is there where its channel is. */
const ROWS = [
  { id: "feed_drive", title: "cycle.feedDrive", short: "feed_drive", un: "%", main: "ffd", raw: "fd", color: "--sig-feed-drive", set: "feed_drive", digits: 1, h: 112 },
  { id: "spindle", title: "cycle.spindle", short: "spindle", un: "%", main: "fsp", raw: "sp", color: "--sig-spindle", set: "spindle", digits: 1, h: 112 },
  { id: "thrust", title: "cycle.thrust", un: "N", main: "thrust", color: "--sig-feed-drive", digits: 0, h: 104, unless: "ffd" },
  { id: "torque", title: "cycle.torque", un: "N\u00b7m", main: "torque", color: "--sig-spindle", digits: 2, h: 104, unless: "fsp" },
  { id: "power", title: "cycle.power", un: "W", main: "power", color: "--sig-spindle", digits: 0, h: 104, unless: "fsp" },
  { id: "feed", title: "cycle.feed", un: "mm/min", main: "f", plan: "fpr", color: "--sig-feed", digits: 0, h: 104 },
  { id: "override", title: "cycle.override", un: "%", main: "ovr", color: "--sig-override", digits: 0, h: 78, mark: 100 },
  { id: "energy", title: "cycle.energySoFar", un: "J", main: "e", color: "--sig-energy", digits: 0, h: 104, total: true },
];
const CHANNELS = { fd: "feed_drive_load_percent", sp: "spindle_load_percent", f: "feed_actual_mm_min", fpr: "feed_programmed_mm_min", ovr: "override_percent", thrust: "thrust_newtons", torque: "torque_newton_metres", power: "spindle_power_watts", z: "depth_mm" };

/** A distance of two samples above this many usual ones is a gap, as the stored cycle's flags have it. */
const GAP = 3;
const median = (values) => { const list = values.filter(Number.isFinite).sort((a, b) => a - b), half = list.length >> 1; return list.length === 0 ? Infinity : list.length % 2 ? list[half] : (list[half - 1] + list[half]) / 2; };
/** A cycle with its curves over both axes. */
function curves(cycle, samples, course) {
  const length = Object.values(samples).find((column) => Array.isArray(column))?.length ?? 0;
  const contact = course?.contact?.time_ms ?? 0;
  const at = Array.from({ length }, (_, i) => ((samples.time_ms ? samples.time_ms[i] : (i + 1) * samples.period_ms) - contact) / 1000);
  const columns = Object.fromEntries(Object.entries(CHANNELS).filter(([, name]) => samples[name]).map(([key, name]) => [key, samples[name]]));
  columns.t = at;
  columns.ffd = course?.filtered_feed_drive_load_percent ?? columns.fd;
  columns.fsp = course?.filtered_spindle_load_percent ?? columns.sp;
  columns.e = course?.energy_joules;
  const steps = [], first = [];
  for (let i = 0; i < length; i++) if (i === 0 || at[i] > at[steps.at(-1)]) { steps.push(i); if (at[i] >= -APPROACH_S) first.push(i); }
  // Where nothing was measured for longer than usual the lines break: what lies between is not known.
  const apart = samples.time_ms?.slice(1).map((value, i) => value - samples.time_ms[i]) ?? [];
  const usual = median(apart.filter((ms) => ms > 0));
  const track = (places, x) => {
    const kept = Object.entries(columns).filter(([, column]) => column), xs = [], made = Object.fromEntries(kept.map(([key]) => [key, []]));
    places.forEach((i, n) => {
      const before = places[n - 1];
      if (n && apart[before] > GAP * usual) { xs.push((x[before] + x[i]) / 2); for (const [key] of kept) made[key].push(null); }
      xs.push(x[i]);
      for (const [key, column] of kept) made[key].push(column[i]);
    });
    return new Track(xs, made);
  };
  const timed = track(first, at);
  const places = columns.z ? forward(columns.z, APPROACH_MM) : [];
  const deep = places.length > 1 ? track(places, columns.z) : null;
  return { cycle, course, tracks: { t: timed, z: deep } };
}
async function load(machine, id) {
  const cycle = await get(cyclePath(machine, id));
  if (!cycle.has_samples) return { cycle, course: null, tracks: { t: null, z: null } };
  const [samples, course] = await Promise.all([get(`${cyclePath(machine, id)}/samples`), get(`${cyclePath(machine, id)}/course`)]);
  return curves(cycle, samples, course);
}

let A = null, B = null, kind = "none", axisOf = "z", plots = [], pin = null, whole = [0, 1], question = null, recent = [];
const rowsShown = () => ROWS.filter((row) => A.tracks[axisOf].has(row.main) && !(row.unless && A.tracks[axisOf].has(row.unless)));
const placeX = (place) => axisOf === "z" ? place.depth_mm : (place.time_ms - (A.course.contact?.time_ms ?? 0)) / 1000;
const setOf = (row, of = A) => row.set ? of.course?.[`${row.set}_load_set_percent`] ?? null : null;

function scaleOf(row) {
  let low = 0, high = 0;
  for (const one of [A, B]) {
    const track = one?.tracks[axisOf];
    for (const name of [row.main, row.raw, row.plan]) {
      if (!track?.has(name)) continue;
      const seen = track.extremes(name, 0, track.x.length);
      if (seen) { low = Math.min(low, seen[0]); high = Math.max(high, seen[1]); }
    }
  }
  const set = setOf(row);
  if (set) high = Math.max(high, set * 1.3);
  if (row.mark) high = Math.max(high, row.mark * 1.2);
  return [low < 0 ? -nice(-low) * (low < -0.05 * high ? 1 : 0) : 0, nice(high * 1.05)];
}

function build() {
  plots.forEach((plot) => plot.destroy());
  plots = [];
  const host = fill($("#charts"), "");
  const a = A.tracks[axisOf], b = B?.tracks[axisOf];
  const ends = [a, b].filter(Boolean).flatMap((track) => [track.x[0], track.x[track.x.length - 1]]);
  const pad = (Math.max(...ends) - Math.min(...ends)) * 0.01 || 0.5; // one sample has no extent
  whole = [Math.min(...ends) - pad, Math.max(...ends) + pad];
  const rows = rowsShown(), last = rows.at(-1), stages = A.course?.stages ?? [];
  rows.forEach((row, n) => {
    const first = n === 0, wrap = element(html`<div class="row ${first && stages.length ? "first" : ""}"><div class="chart-title"><b>${t(row.title)}</b><span>${row.un}</span></div><div class="u-wrap"></div></div>`);
    host.append(wrap);
    const box = $(".u-wrap", wrap), [low, high] = scaleOf(row), top = first && stages.length ? 26 : 6;
    const plot = chart(box, {
      height: row.h + (row === last ? 30 : 0) + (top - 6), pad: [top, phone() ? 10 : 96, 0, 0], axisX: row === last, left: 48, xr: whole, range: () => [low, high], ysplits: () => splits(low, high).filter((_, i, list) => list.length < 5 || i % 2 === 0),
      aria: t("cycle.rowAria", { row: t(row.title), unit: row.un, axis: t(axisOf === "z" ? "cycle.axisDepth" : "cycle.axisTime") }),
      back: (u, c) => stages.forEach((stage, i) => { if (i % 2) { const from = X(u, placeX(stage.from)), to = X(u, placeX(stage.to)); c.fillStyle = token("--stage-b"); c.fillRect(from, 0, to - from, 9e3); } }),
      front: (u, c) => draw(u, c, row, first ? stages : null),
      onCursor: (u) => { if (u.cursor.left >= 0 && u.cursor.event) move(u.posToVal(u.cursor.left, "x"), u); },
      onScale: (u) => follow(u),
    });
    plot.zoomed = false;
    plot.row = row;
    plots.push(plot);
    const hair = element(html`<i class="hair"></i>`), dots = [row.main, ...(b?.has(row.main) ? ["compared"] : [])].map(() => element(html`<i class="dot-mark"></i>`));
    plot.over.append(hair, ...dots);
    plot.hair = hair; plot.dots = dots;
    box.addEventListener("dblclick", resetZoom);
    box.addEventListener("mouseleave", () => { pin ??= middle(); readout(pin); });
    box.addEventListener("wheel", (event) => { if (!event.ctrlKey && !event.shiftKey) return; event.preventDefault(); const rect = plot.over.getBoundingClientRect(), part = (event.clientX - rect.left) / rect.width; if (event.ctrlKey) zoomBy(event.deltaY > 0 ? 1.25 : 0.8, part); else panBy((event.deltaY || event.deltaX) > 0 ? 0.08 : -0.08); }, { passive: false });
  });
  $("#xname").textContent = t(axisOf === "z" ? "cycle.xDepth" : "cycle.xTime");
  pin ??= middle();
  if (pin < whole[0] || pin > whole[1]) pin = middle();
  requestAnimationFrame(() => readout(pin));
}
const middle = () => { const b = A.course?.stages?.find((stage) => stage.stage === "B"); return b ? (placeX(b.from) + placeX(b.to)) / 2 : (whole[0] + whole[1]) / 2; };
/** All rows show the same part of x. */
function window_(min, max, zoomed = true) { for (const plot of plots) { plot.zoomed = zoomed; plot.quiet = true; plot.setScale("x", { min, max }); plot.quiet = false; } requestAnimationFrame(() => mark(pin)); }
function follow(u) { if (u.quiet || plots.length === 0) return; const { min, max } = u.scales.x; if (u.zoomed || (min === whole[0] && max === whole[1])) return; window_(min, max); }
const resetZoom = () => window_(whole[0], whole[1], false);
const seen = () => { const { min, max } = plots[0].scales.x; return [min, max]; };
function zoomBy(factor, part = 0.5) { const [min, max] = seen(), at = min + (max - min) * part, span = Math.min(whole[1] - whole[0], Math.max((whole[1] - whole[0]) / 2000, (max - min) * factor)); let from = Math.max(whole[0], at - span * part); from = Math.min(from, whole[1] - span); window_(from, from + span); }
function panBy(share) { const [min, max] = seen(), span = max - min, from = Math.min(whole[1] - span, Math.max(whole[0], min + span * share)); window_(from, from + span); }

function draw(u, c, row, stages) {
  const k = dpr(), a = A.tracks[axisOf], b = B?.tracks[axisOf], predicted = kind === "whatif";
  if (b) line(u, b, row.main, { color: "--sig-reference", width: 1.25, dash: predicted ? [4, 3] : [] });
  if (row.raw && row.raw !== row.main && a.has(row.raw)) line(u, a, row.raw, { color: row.color, width: 0.75, alpha: 0.42 });
  if (row.plan) line(u, a, row.plan, { color: row.color, width: 1.25, dash: [4, 3] });
  line(u, a, row.main, { color: row.color });
  const set = setOf(row);
  if (set != null) {
    const mine = (A.course.overloads ?? []).filter((one) => one.drive === row.set);
    c.save(); clip(u);
    const y = Y(u, set);
    for (const one of mine) { // what lies over a limit is filled: the only warm area of the page
      const from = placeX(one.from), to = placeX(one.to);
      c.save(); c.beginPath(); c.rect(X(u, from), u.bbox.top, Math.max(1, X(u, to) - X(u, from)), y - u.bbox.top); c.clip();
      c.beginPath(); c.moveTo(X(u, from), y);
      a.each(row.main, Math.max(from, u.scales.x.min), Math.min(to, u.scales.x.max), Math.round(u.bbox.width), (x, low, high) => { if (!Number.isNaN(high)) c.lineTo(X(u, x), Y(u, Math.max(high, set))); });
      c.lineTo(X(u, to), y); c.closePath(); c.fillStyle = token("--act"); c.globalAlpha = 0.85; c.fill(); c.restore();
    }
    c.restore();
    const other = predicted ? question?.[row.set] : null;
    const close = other != null && Math.abs(Y(u, other) - Y(u, set)) < 15 * k;
    limit(u, c, set, `L_set ${num(set, set % 1 ? 1 : 0)}${NB}%`, { shift: close ? (other > set ? 8 : -8) : 0 });
    if (other != null) limit(u, c, other, t("cycle.whatIfLimit", { value: `${num(other, other % 1 ? 1 : 0)}${NB}%` }), { color: "--sig-reference", shift: close ? (other > set ? -8 : 8) : 0 });
    const taken = [];
    for (const one of [...mine].sort((a, b) => b.to.time_ms - b.from.time_ms - a.to.time_ms + a.from.time_ms)) {
      const middleX = X(u, (placeX(one.from) + placeX(one.to)) / 2), top = Math.max(u.bbox.top + 11 * k, Math.min(Y(u, set) - 14 * k, Y(u, one.highest_percent) - 4 * k)), seconds = (one.to.time_ms - one.from.time_ms) / 1000;
      if (middleX < u.bbox.left || middleX > u.bbox.left + u.bbox.width) continue;
      c.fillStyle = token("--act"); c.beginPath(); c.moveTo(middleX - 4.5 * k, top - 7 * k); c.lineTo(middleX + 4.5 * k, top - 7 * k); c.lineTo(middleX, top); c.closePath(); c.fill();
      c.font = `600 ${12 * k}px ${FONT}`; c.textAlign = "left"; c.textBaseline = "middle";
      const text = unit(seconds, "s", 2), from = middleX - 6 * k, to = middleX + 13 * k + c.measureText(text).width;
      // The longest are named; the table names them all.
      if (seconds >= 0.1 && to < u.bbox.left + u.bbox.width && taken.every((other) => to < other[0] || from > other[1])) { halo(c, text, middleX + 9 * k, top - 4 * k); taken.push([from, to]); } else taken.push([from, middleX + 6 * k]);
    }
  }
  if (row.mark) limit(u, c, row.mark, phone() ? "" : t("cycle.asProgrammed"), { color: "--ink-3", dash: [2, 3], width: 1 });
  if (row.total && !phone()) totals(u, c, row, a, b);
  if (row.plan && a.has(row.plan) && !phone()) nameLines(u, c, row, a);
  if (stages?.length) stageNames(u, c, stages);
}
function nameLines(u, c, row, a) {
  const k = dpr(), { min, max } = u.scales.x, at = min + (max - min) * 0.72, plan = a.at(row.plan, at), actual = a.at(row.main, at);
  if (plan == null || actual == null || Math.abs(plan - actual) < (u.scales.y.max - u.scales.y.min) * 0.12) return;
  c.textAlign = "center"; c.fillStyle = token(row.color);
  c.font = `${12 * k}px ${FONT}`; c.textBaseline = plan < actual ? "top" : "bottom"; halo(c, t("cycle.programmed"), X(u, at), Y(u, plan) + (plan < actual ? 5 : -5) * k);
  c.font = `600 ${12 * k}px ${FONT}`; c.textBaseline = plan < actual ? "bottom" : "top"; halo(c, t("cycle.actual"), X(u, at), Y(u, actual) + (plan < actual ? -5 : 5) * k);
}
function totals(u, c, row, a, b) {
  const k = dpr(), end = (track) => track?.has(row.main) ? track.columns[row.main].at(-1) : null, mine = end(a), other = end(b);
  if (mine == null || u.scales.x.max < whole[1] * 0.999) return;
  const ya = Y(u, mine), yb = other == null ? null : Y(u, other), gap = 15 * k, near = yb != null && Math.abs(ya - yb) < gap, mid = near ? (ya + yb) / 2 : 0;
  c.textAlign = "left"; c.textBaseline = "middle";
  const x = u.bbox.left + u.bbox.width + 8 * k;
  c.font = `600 ${12 * k}px ${FONT}`; c.fillStyle = token(row.color); c.fillText(unit(mine, row.un), x, near ? mid + (ya < yb ? -gap / 2 : gap / 2) : ya);
  if (yb != null) { c.font = `${12 * k}px ${FONT}`; c.fillStyle = token("--ink-3"); c.fillText(unit(other, row.un), x, near ? mid + (ya < yb ? gap / 2 : -gap / 2) : yb); }
}
function stageNames(u, c, stages) {
  const k = dpr(), left = u.bbox.left, right = left + u.bbox.width, y = 12 * k;
  stages.forEach((stage, i) => {
    const from = X(u, placeX(stage.from)), to = X(u, placeX(stage.to)), a = Math.max(left, from), b = Math.min(right, to);
    if (b < left + 8 * k || a > right - 8 * k) return;
    c.font = `600 ${12 * k}px ${FONT}`; c.textBaseline = "middle"; c.textAlign = "center"; c.fillStyle = token("--ink");
    const full = `${stage.stage}  ${t(`stage.${stage.stage}`)}`;
    c.fillText(c.measureText(full).width < b - a - 10 * k ? full : stage.stage, (a + b) / 2, y);
    c.strokeStyle = token("--line-strong"); c.lineWidth = k; c.beginPath();
    if (to <= right + k) { c.moveTo(Math.round(to) + 0.5, 3 * k); c.lineTo(Math.round(to) + 0.5, u.bbox.top); }
    if (i === 0 && from >= left - k) { c.moveTo(Math.round(from) + 0.5, 3 * k); c.lineTo(Math.round(from) + 0.5, u.bbox.top); }
    c.stroke();
  });
}

function move(x) { pin = x; readout(x); }
/** Where x stands in what the rows show now: all that a zoom changes of what is read out. */
function mark(x) {
  if (plots.length === 0 || x == null) return;
  const a = A.tracks[axisOf], b = B?.tracks[axisOf];
  for (const plot of plots) {
    // The width as the plot knows it: asking the page for it in the midst of changes would lay it out for every row.
    const left = plot.valToPos(x, "x"), inside = left >= 0 && left <= plot.bbox.width / dpr();
    plot.hair.hidden = !inside; plot.hair.style.transform = `translateX(${left}px)`;
    [a.at(plot.row.main, x), b?.at(plot.row.main, x)].forEach((value, i) => { const dot = plot.dots[i]; if (!dot) return; dot.hidden = !inside || value == null; if (value != null) dot.style.transform = `translate(${left}px, ${plot.valToPos(value, "y")}px)`; dot.className = `dot-mark ${i ? "other" : ""}`; dot.style.borderColor = i ? "" : `var(${plot.row.color})`; });
  }
}
/** What stands at x, in the table and on the lines. */
function readout(x) {
  if (plots.length === 0 || x == null) return;
  mark(x);
  const a = A.tracks[axisOf], b = B?.tracks[axisOf];
  const z = axisOf === "z" ? x : a.at("z", x), s = axisOf === "t" ? x : a.at("t", x);
  put($("#at"), [z == null ? null : unit(z, "mm", 2), s == null ? null : unit(s, "s", 2)].filter(Boolean).join(", "));
  const stage = (A.course?.stages ?? []).find((one) => x >= placeX(one.from) && x < placeX(one.to));
  put($("#stage"), stage ? t("cycle.inStage", { stage: stage.stage, name: t(`stage.${stage.stage}`) }) : A.course?.contact && x < placeX(A.course.contact) ? t("cycle.beforeContact") : "");
  const rows = rowsShown().flatMap((row) => [...(row.plan && a.has(row.plan) ? [{ title: t("cycle.programmedFeed"), un: row.un, name: row.plan, digits: row.digits, color: row.color, dash: true }] : []), { title: t(row.plan ? "cycle.actualFeed" : row.title), un: row.un, name: row.main, digits: row.digits, color: row.color }]);
  put($("#read"), html`${rows.map((row) => { const one = a.at(row.name, x), two = b?.at(row.name, x); return html`<tr><th scope="row"><span class="swatch"><svg viewBox="0 0 14 8" width="14" height="8" aria-hidden="true"><path d="M0 4h14" stroke="${trusted(`var(${row.color})`)}" stroke-width="2.4" ${row.dash ? trusted('stroke-dasharray="4 3"') : ""}/></svg><span>${row.title}<span class="unit">, ${row.un}</span></span></span></th><td class="num">${num(one, row.digits)}</td><td class="num faint">${B ? num(two, row.digits) : ""}</td><td class="num">${one == null || two == null ? "" : signed(one - two, row.digits)}</td></tr>`; })}`);
}

const overloadSeconds = (of) => of?.course ? of.course.overloads.reduce((sum, one) => sum + (one.to.time_ms - one.from.time_ms) / 1000, 0) : null;
function figures() {
  const s = A.cycle.summary, r = kind === "whatif" ? null : B?.cycle.summary, w = kind === "whatif" ? B?.answer : null;
  const best = s.energy[0], bestOther = r?.energy.find((one) => one.basis === best?.basis);
  const limits = A.course ? { feed_drive: A.course.feed_drive_load_set_percent, spindle: A.course.spindle_load_set_percent } : {};
  const versus = (value, digits) => value == null ? "" : t("cycle.compared", { value: num(value, digits) });
  const limited = (value) => value == null ? "" : t("cycle.limit", { value: `${num(value, value % 1 ? 1 : 0)}${NB}%` });
  const items = w ? [
    [t("cycle.fromContact"), w.happened.duration_s, "s", 2, versus(w.predicted.duration_s, 2)],
    [t("cycle.energySpindle", { basis: t(`basis.${w.assumed.energy_basis}`) }), w.happened.energy_j, "J", 0, versus(w.predicted.energy_j, 0)],
    [t("cycle.highestFeedDrive"), w.happened.peak_feed_drive_percent, "%", 1, versus(w.predicted.peak_feed_drive_percent, 1)],
    [t("cycle.highestSpindle"), w.happened.peak_spindle_percent, "%", 1, versus(w.predicted.peak_spindle_percent, 1)],
    [t("cycle.timeOver"), w.happened.overload_s, "s", 2, versus(w.predicted.overload_s, 2)],
    [t("cycle.modelError"), w.model_error.duration_relative * 100, "%", 1, t("cycle.modelErrorWhat"), true],
  ] : [
    [t("cycle.time"), s.duration_ms == null ? null : s.duration_ms / 1000, "s", 2, versus(r?.duration_ms == null ? null : r.duration_ms / 1000, 2)],
    [best ? t("cycle.energyBasis", { basis: t(`basis.${best.basis}`) }) : t("cycle.energy"), best?.total_joules, "J", 0, versus(bestOther?.total_joules, 0)],
    [t("cycle.highestFeedDrive"), s.max_feed_drive_load_percent?.value, "%", 1, [limited(limits.feed_drive), versus(r?.max_feed_drive_load_percent?.value, 1)].filter(Boolean).join(", ")],
    [t("cycle.highestSpindle"), s.max_spindle_load_percent?.value, "%", 1, [limited(limits.spindle), versus(r?.max_spindle_load_percent?.value, 1)].filter(Boolean).join(", ")],
    [t("cycle.meanOverride"), s.mean_override_percent, "%", 0, versus(r?.mean_override_percent, 0)],
    [t("cycle.timeOver"), limits.feed_drive == null && limits.spindle == null ? null : overloadSeconds(A), "s", 2, limits.feed_drive == null && limits.spindle == null ? t("cycle.noLimits") : versus(overloadSeconds(B), 2)],
  ];
  put($("#figures"), html`${items.map(([name, value, un, digits, vs, sign]) => html`<div><dt title="${name}">${name}</dt><dd>${value == null ? html`<span class="faint">${t("unknown")}</span>` : html`${sign ? signed(value, digits) : num(value, digits)} <span class="unit">${un}</span>`}</dd><dd class="vs">${vs || trusted("&nbsp;")}</dd></div>`)}`);
  put($("#stages"), html`${(A.course?.stages ?? []).map((one) => { const other = B?.course?.stages?.find((stage) => stage.stage === one.stage); return html`<tr><th scope="row"><b>${one.stage}</b> ${t(`stage.${one.stage}`)}</th><td class="num">${one.from.depth_mm == null ? "" : `${num(one.from.depth_mm, 1)} ${t("to")} ${num(one.to.depth_mm, 1)}`}</td><td class="num">${num((one.to.time_ms - one.from.time_ms) / 1000, 2)}</td><td class="num">${one.energy_joules == null ? "" : num(one.energy_joules)}</td><td class="num faint">${other?.energy_joules == null || one.energy_joules == null ? "" : signed(one.energy_joules - other.energy_joules)}</td></tr>`; })}`);
  const over = A.course?.overloads ?? [];
  put($("#over"), html`${over.slice(0, KEYS).map((one) => html`<tr><th scope="row"><svg class="mark" viewBox="0 0 10 8" width="10" height="8" role="img" aria-label="${t("cycle.over")}"><path d="M0 0h10L5 8z" fill="var(--act)"/></svg></th><td>${t(one.drive === "spindle" ? "cycle.spindleShort" : "cycle.feedDriveShort")}</td><td class="num">${one.from.depth_mm == null ? unit(one.from.time_ms / 1000, "s", 2) : `${num(one.from.depth_mm, 1)} ${t("to")} ${unit(one.to.depth_mm, "mm", 1)}`}</td><td class="num">${unit((one.to.time_ms - one.from.time_ms) / 1000, "s", 2)}</td><td class="num">${unit(one.highest_percent, "%", 1)}</td></tr>`)}`);
  $("#over-none").hidden = over.length > 0;
  $("#over-none").textContent = limits.feed_drive == null && limits.spindle == null ? t("cycle.noLimitsLong") : t("cycle.neverOver");
  $("#stages-none").hidden = Boolean(A.course?.stages?.length);
  for (const button of $$("#compare button")) button.setAttribute("aria-pressed", String(button.value === kind));
  for (const button of $$("#xaxis button")) button.setAttribute("aria-pressed", String(button.value === axisOf));
  put($("#refkey"), B ? html`<svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-reference)" stroke-width="1.6" ${kind === "whatif" ? trusted('stroke-dasharray="4 3"') : ""}/></svg><span>${B.name}</span>` : "");
  verdict();
}
function verdict() {
  const over = A.course?.overloads ?? [], s = A.cycle.summary;
  let sign = "note", text;
  if (A.cycle.outcome === "aborted") { sign = "plan"; text = t("cycle.aborted"); }
  else if (over.length) {
    const worst = over.reduce((most, one) => one.to.time_ms - one.from.time_ms > most.to.time_ms - most.from.time_ms ? one : most);
    text = t("cycle.wasOver", { drive: t(worst.drive === "spindle" ? "cycle.theSpindle" : "cycle.theFeedDrive"), limit: `${num(setOf({ set: worst.drive }), 0)}${NB}%`, seconds: unit((worst.to.time_ms - worst.from.time_ms) / 1000, "s", 2), where: worst.from.depth_mm == null ? "" : t("cycle.atDepth", { from: num(worst.from.depth_mm, 1), to: unit(worst.to.depth_mm, "mm", 1) }) });
  } else if (A.course && (A.course.feed_drive_load_set_percent != null || A.course.spindle_load_set_percent != null)) text = t("cycle.stayedUnder");
  else text = t("cycle.finished", { time: s.duration_ms == null ? "" : unit(s.duration_ms / 1000, "s", 2) });
  const odd = s.flags.filter((flag) => flag !== "feed_hold");
  put($("#verdict"), html`${icon(sign)}<span>${text}${odd.length ? html` <span class="muted">${t("cycle.flags")} ${odd.map((flag) => told("flag", flag, flag)).join(", ")}.</span>` : ""}</span>`);
}

async function compareNew() {
  // The last of the cycles that the baseline of this tool's life was learnt from.
  const c = A.cycle, [wear, events] = await Promise.all([get(`/v1/tools/${segment(c.tool)}/wear`), get(`/v1/tools/${segment(c.tool)}/events?limit=1000`)]);
  const begins = events.items.filter((event) => event.kind !== "conditions_confirmed" && !event.revoked_at && Date.parse(event.at) <= Date.parse(c.started_at)).map((event) => event.at).sort().at(-1);
  const baseline = wear.baselines.find((one) => one.operation === c.operation && one.machine === c.machine && one.strategy === c.strategy);
  const page = await get(`/v1/cycles?tool=${segment(c.tool)}&machine=${segment(c.machine)}&operation=${segment(c.operation)}&limit=50${begins ? `&from=${segment(begins)}` : ""}`);
  const usable = page.items.filter((one) => one.has_samples && one.outcome === "completed" && one.strategy === c.strategy).slice(0, Math.max(1, baseline?.needed ?? 5));
  const found = usable.at(-1);
  if (!found) throw new ApiError(404, { code: "no_new", detail: t("cycle.noNew") });
  return found;
}
async function compare(to, id) {
  const said = $("#said");
  put(said, "");
  try {
    if (to === "none") { B = null; } else if (to === "whatif") { await runWhatIf(); } else {
      const found = to === "new" ? await compareNew() : { machine: A.cycle.machine, cycle_id: id };
      if (found.cycle_id === A.cycle.cycle_id) { put(said, notice("", t("cycle.isTheNew"))); return; }
      B = await load(found.machine, found.cycle_id);
      B.name = to === "new" ? t("cycle.whenNew", { time: moment(B.cycle.started_at) }) : t("cycle.otherAt", { time: moment(B.cycle.started_at) });
      if (!B.tracks.t) { B = null; put(said, notice("plan", t("cycle.noSamplesOther"))); return; }
      if (axisOf === "z" && !B.tracks.z) axisOf = "t";
    }
    kind = B ? to : "none";
    $("#whatif").hidden = kind !== "whatif";
    figures();
    build();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    put(said, error.code === "cycle_not_usable" || GONE.has(error.code) ? notice("", t("cycle.noWhatIf"), told("whatif", GONE.has(error.code) ? "samples_dropped" : error.reason ?? "", error.message)) : failure(error));
  }
}
/** The same depths under another control, as the identified load–feed relation predicts them. */
async function runWhatIf() {
  const paper = { feed_drive: 30, spindle: 40 };
  const now = { feed_drive: A.course?.feed_drive_load_set_percent ?? paper.feed_drive, spindle: A.course?.spindle_load_set_percent ?? paper.spindle };
  question ??= { feed_drive: now.feed_drive + 10, spindle: now.spindle + 10 };
  $("#wi-feed").value = written(question.feed_drive); $("#wi-spindle").value = written(question.spindle);
  const answer = await post(`${cyclePath(A.cycle.machine, A.cycle.cycle_id)}/what-if`, { control: { law: { set_feed_drive_percent: question.feed_drive, set_spindle_percent: question.spindle } }, limits: { feed_drive_percent: now.feed_drive, spindle_percent: now.spindle }, samples: true });
  B = predicted(answer);
  put($("#wi-trust"), html`<dl class="facts"><dt>${t("whatif.rmsFeed")}</dt><dd>${unit(answer.model_error.feed_drive_rms_points, "%", 1)}</dd><dt>${t("whatif.rmsSpindle")}</dt><dd>${unit(answer.model_error.spindle_rms_points, "%", 1)}</dd><dt>${t("whatif.duration")}</dt><dd>${signed(answer.model_error.duration_relative * 100, 1)}${NB}%</dd><dt>${t("whatif.extrapolated")}</dt><dd>${unit(answer.extrapolated_ratio * 100, "%", 0)}</dd><dt>${t("whatif.learned")}</dt><dd>${num(answer.relation.learned_from.length)}</dd></dl>`);
}
function predicted(answer) {
  const s = answer.predicted_samples, name = t("cycle.whatIfName", { feed: `${num(question.feed_drive)}${NB}%`, spindle: `${num(question.spindle)}${NB}%` });
  const length = s.depth_mm.length, at = Array.from({ length }, (_, i) => (i + 1) * s.period_ms / 1000);
  const columns = { t: at, z: s.depth_mm, ffd: s.feed_drive_load_percent, fsp: s.spindle_load_percent, f: s.feed_actual_mm_min, ovr: s.override_percent };
  const places = forward(s.depth_mm, -1e9);
  return { name, answer, cycle: A.cycle, course: null, tracks: { t: new Track(at, columns), z: new Track(places.map((i) => s.depth_mm[i]), Object.fromEntries(Object.entries(columns).map(([key, column]) => [key, places.map((i) => column[i])]))) } };
}

function frame(who) {
  const c = A.cycle, whatIf = may(who, "POST /v1/machines/{machine}/cycles/{cycle_id}/what-if");
  const facts = [moment(c.started_at), html`${t("nav.tool")} <a href="/tool?id=${segment(c.tool)}">${c.tool}</a>`, t("cycle.ofOperation", { operation: c.operation }), c.profile_id ? t("cycle.ofProfile", { profile: c.profile_id, version: c.profile_version }) : null, c.strategy ? told("strategy", c.strategy) : null, c.spindle_speed_rpm == null ? null : unit(c.spindle_speed_rpm, t("unit.rpm"))].filter(Boolean);
  fill($("#main"), html`<div class="head">
    <div class="titles"><p class="crumbs"><a href="/">${t("nav.fleet")}</a> / <a href="/cycle?machine=${segment(c.machine)}">${c.machine}</a> / ${t("nav.cycle")}</p>
      <h1>${t("cycle.title", { id: c.seq == null ? c.cycle_id : num(c.seq), machine: c.machine })}</h1>
      <p class="evidence">${facts.map((fact, i) => html`${i ? ", " : ""}${fact}`)}.</p></div>
    <div class="tools">
      <div class="seg" id="compare" role="group" aria-label="${t("cycle.compareWith")}"><button value="none">${t("cycle.compareNone")}</button><button value="new">${t("cycle.compareNew")}</button><button value="whatif" ${whatIf ? "" : html`aria-disabled="true"`}>${t("cycle.compareWhatIf")}</button></div>
      <div class="seg" id="xaxis" role="group" aria-label="${t("cycle.axis")}"><button value="z" ${A.tracks.z ? "" : html`disabled`}>${t("cycle.axisDepth")}</button><button value="t">${t("cycle.axisTime")}</button></div>
      <label class="sr" for="other">${t("cycle.other")}</label><select id="other"><option value="">${t("cycle.other")}</option></select>
    </div></div>
  <p class="verdict sub" id="verdict"></p><div id="live-cycle"></div><div id="said"></div>
  <section class="panel whatif" id="whatif" hidden aria-label="${t("cycle.compareWhatIf")}"><form id="wi-form" novalidate><p>${t("whatif.what")}</p><label for="wi-feed">${t("whatif.feed")}</label>${numeric("wi-feed", null)}<span class="unit">%</span><label for="wi-spindle">${t("whatif.spindle")}</label>${numeric("wi-spindle", null)}<span class="unit">%</span><button class="btn" type="submit">${t("whatif.ask")}</button><p class="said" id="wi-said" role="alert"></p></form><div id="wi-trust"></div></section>
  <dl class="figures six" id="figures"></dl>
  <div class="cycle-grid"><section class="panel charts-panel" aria-label="${t("cycle.curves")}">
      <div class="key"><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--ink)" stroke-width="2.2"/></svg>${t("cycle.this")}</span><span id="refkey"></span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-limit)" stroke-width="1.3" stroke-dasharray="5 4"/></svg>${t("cycle.dashed")}</span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M5 0h10l-5 8z" fill="var(--act)"/></svg>${t("cycle.overTheLimit")}</span><span class="hint">${t("cycle.hint")}</span></div>
      <div id="charts" tabindex="0" role="group" aria-label="${t("cycle.keys")}"></div><p class="xname" id="xname"></p></section>
    <aside class="stack" aria-label="${t("cycle.values")}">
      <section class="panel"><header><h2>${t("cycle.atCursor")}</h2><span class="end small" id="at"></span></header><div class="body"><p class="small muted" id="stage"></p><table class="tight"><thead><tr><th scope="col"><span class="sr">${t("cycle.signal")}</span></th><th scope="col" class="num">${t("cycle.thisShort")}</th><th scope="col" class="num">${t("cycle.comparedShort")}</th><th scope="col" class="num">${t("cycle.change")}</th></tr></thead><tbody id="read"></tbody></table></div></section>
      <section class="panel"><header><h2>${t("cycle.stages")}</h2><span class="end tiny faint">${t("cycle.byLoad")}</span></header><div class="body"><table class="tight"><thead><tr><th scope="col">${t("cycle.stage")}</th><th scope="col" class="num">${t("cycle.depthMm")}</th><th scope="col" class="num">s</th><th scope="col" class="num">J</th><th scope="col" class="num">${t("cycle.changeJ")}</th></tr></thead><tbody id="stages"></tbody></table><p class="small muted" id="stages-none" hidden>${t("cycle.noStages")}</p></div></section>
      <section class="panel"><header><h2>${t("cycle.overTitle")}</h2><span class="end tiny faint">${t("cycle.overWhat")}</span></header><div class="body"><table class="tight"><thead class="sr"><tr><th scope="col">${t("cycle.over")}</th><th scope="col">${t("cycle.drive")}</th><th scope="col">${t("cycle.depthMm")}</th><th scope="col">${t("cycle.axisTime")}</th><th scope="col">${t("cycle.highest")}</th></tr></thead><tbody id="over"></tbody></table><p class="small muted" id="over-none" hidden></p></div></section>
    </aside></div>`);
  fill($("#other"), html`<option value="">${t("cycle.other")}</option>${recent.map((one) => html`<option value="${one.cycle_id}">${dayMonth(one.started_at)}, ${time(one.started_at)}  ${one.tool}${one.energy_joules == null ? "" : `  ${unit(one.energy_joules, "J")}`}</option>`)}`);
  $("#compare").addEventListener("click", (event) => { const button = event.target.closest("button"); if (button && button.getAttribute("aria-disabled") !== "true") compare(button.value); });
  $("#xaxis").addEventListener("click", (event) => { const button = event.target.closest("button"); if (!button) return; axisOf = button.value; pin = null; figures(); build(); });
  $("#other").addEventListener("change", (event) => { if (event.target.value) compare("other", event.target.value); });
  $("#wi-form").addEventListener("submit", (event) => { event.preventDefault(); const found = entered([$("#wi-feed"), $("#wi-spindle")], { needed: true, say: () => $("#wi-said") }); if (!found) return; question = { feed_drive: found[0], spindle: found[1] }; compare("whatif"); });
  $("#charts").addEventListener("keydown", keys);
}
function keys(event) {
  const [min, max] = seen(), step = (max - min) / (event.altKey ? 1000 : 100);
  const act = { ArrowLeft: () => event.shiftKey ? panBy(-0.1) : move(Math.max(min, pin - step)), ArrowRight: () => event.shiftKey ? panBy(0.1) : move(Math.min(max, pin + step)), "+": () => zoomBy(0.8, (pin - min) / (max - min)), "=": () => zoomBy(0.8, (pin - min) / (max - min)), "-": () => zoomBy(1.25, (pin - min) / (max - min)), Home: resetZoom, Escape: resetZoom }[event.key];
  if (!act) return;
  event.preventDefault();
  act();
}
function bare() {
  // Reported only, or its samples are gone: what is known is still told.
  $("#charts").replaceChildren(element(empty(t("cycle.noSamples"), t("cycle.noSamplesText"))));
  for (const id of ["#compare", "#xaxis"]) for (const button of $$(`${id} button`)) button.disabled = true;
  figures();
}

async function which(machine) {
  const one = await get(`/v1/fleet/${segment(machine)}?recent=${RECENT}`);
  recent = one.recent;
  return one.last_cycle?.cycle_id ?? null;
}
shell(t("nav.cycle"));
fill($("#main"), html`<div class="panel body">${skeleton(6)}</div>`);
await opening(async () => {
  const who = await session();
  let machine = asked.get("machine"), id = asked.get("id");
  if (!machine) {
    machine = (await wholeFleet(2)).filter((item) => item.last_cycle).sort((a, b) => Date.parse(b.last_cycle.received_at) - Date.parse(a.last_cycle.received_at))[0]?.machine;
  }
  const newest = machine ? await which(machine) : null;
  id ??= newest;
  if (!id) fill($("#main"), html`<section class="panel body">${empty(t("cycle.none"), t("cycle.noneText"), html`<a class="btn" href="/">${t("nav.fleet")}</a>`, true)}</section>`);
  else {
    [A] = await Promise.all([load(machine, id), ready()]);
    document.title = `${t("cycle.title", { id: A.cycle.seq == null ? id : num(A.cycle.seq), machine })} \u2013 Feedwright`;
    frame(who);
    if (A.tracks.t) {
      if (!A.tracks.z) axisOf = "t";
      figures();
      build();
      const first = asked.get("compare");
      if (first) await compare(["new", "whatif"].includes(first) ? first : "other", first);
    } else bare();
    cycleLive(machine, id, newest, $("#live-cycle"));
  }
}, (error) => fill($("#main"), html`<section class="panel body">${error.status === 404 ? empty(t("notfound.title"), t("notfound.text"), html`<a class="btn" href="/">${t("nav.fleet")}</a>`, true) : failure(error, t("error.load"))}</section>`));
