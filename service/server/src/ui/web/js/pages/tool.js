import { $, fill, html, put, trusted } from "../html.js";
import { icon } from "../icons.js";
import { action, closed, shell } from "../shell.js";
import { busy } from "../actions.js";
import { confirm } from "../dialog.js";
import { empty, failure, notice, progress, skeleton } from "../states.js";
import { ApiError, all, get, may, post, segment, serverNow, session, wholeFleet } from "../api.js";
import { NB, age, dayMonth, num, rounded, signed, unit } from "../format.js";
import { FONT, X, Y, chart, clip, dpr, halo, limit, line, phone, ready, splits, token, vline } from "../charts.js";
import { Track } from "../track.js";
import { isHidden, learnt, levelPercent, shownLevel } from "../wear.js";
import { keep, listen, opening } from "../live.js";
import { MOST_REASON, oneLine, t, told } from "../text.js";

const asked = new URLSearchParams(location.search);
const REVOKE = "POST /v1/tools/{tool}/events/{id}/revoke";
const BEAT_MS = 20_000, MOST_CYCLES = 20_000, MOST_TOOLS = 5000;
/** Cycles that are read anew where some have come: what these settle of others lies no further back. */
const TAIL = 500;
/** Each reason has its own shape; there are more reasons than shapes, so the rest share the circle with a dot. */
const shapes = { aborted: "cross", incomplete: "square", air_cut: "circle", broken_suspected: "octagon", clock_suspect: "dot", no_energy: "dot", low_coverage: "diamond", operation_unregistered: "dot", operator_override: "triangle", conditions_changed: "bar", baseline_outlier: "down", cut_short: "dot" };
const glyphs = { square: '<rect x="3" y="3" width="8" height="8"/>', diamond: '<path d="M7 1.5 12.5 7 7 12.5 1.5 7z"/>', triangle: '<path d="M7 2 12 11.5H2z"/>', down: '<path d="M7 12 2 2.5h10z"/>', cross: '<path d="M3 3l8 8M3 11l8-8"/>', circle: '<circle cx="7" cy="7" r="4.5"/>', dot: '<circle cx="7" cy="7" r="4.5"/><circle cx="7" cy="7" r="1" fill="currentColor"/>', octagon: '<path d="M5 2h4l3 3v4l-3 3H5L2 9V5z"/>', bar: '<rect x="2" y="5.5" width="10" height="3"/>' };

let life = null, tool = null, recorded = [], events = [], plots = [], hover = null, who = null;
const numberOf = (i) => life.before + i + 1;

/** Every counted cycle's energy over its own baseline, and the level that was judged after each: what decided may be another
 *  than the energy as run, where the feed varies. */
function level() {
  const counted = [], points = [];
  life.energy_ratio.forEach((ratio, i) => {
    if (ratio != null && life.excluded[i] == null) counted.push([numberOf(i), (ratio - 1) * 100]);
    points.push([numberOf(i), life.level[i] == null || life.decides[i] == null ? null : (life.level[i] - 1) * 100, life.decides[i]]);
  });
  return { counted, points };
}
/** A line that breaks where there is no level, and begins anew where another one decides. */
function levelPath(c, u, points) {
  const step = Math.max(1, Math.floor(points.length / 3000));
  let last = null;
  c.beginPath();
  points.forEach(([n, value, basis], i) => {
    if (i % step && i !== points.length - 1) return;
    if (value == null) { last = null; return; }
    if (last === basis) c.lineTo(X(u, n), Y(u, value)); else c.moveTo(X(u, n), Y(u, value));
    last = basis;
  });
}

function mark(c, x, y, shape, size) {
  c.beginPath();
  if (shape === "square") c.rect(x - size, y - size, 2 * size, 2 * size);
  else if (shape === "bar") c.rect(x - size * 1.3, y - size * 0.5, size * 2.6, size);
  else if (shape === "diamond") { c.moveTo(x, y - size * 1.35); c.lineTo(x + size * 1.35, y); c.lineTo(x, y + size * 1.35); c.lineTo(x - size * 1.35, y); c.closePath(); }
  else if (shape === "triangle") { c.moveTo(x, y - size * 1.3); c.lineTo(x + size * 1.25, y + size); c.lineTo(x - size * 1.25, y + size); c.closePath(); }
  else if (shape === "down") { c.moveTo(x, y + size * 1.3); c.lineTo(x + size * 1.25, y - size); c.lineTo(x - size * 1.25, y - size); c.closePath(); }
  else if (shape === "octagon") { const a = size * 0.5; c.moveTo(x - a, y - size); c.lineTo(x + a, y - size); c.lineTo(x + size, y - a); c.lineTo(x + size, y + a); c.lineTo(x + a, y + size); c.lineTo(x - a, y + size); c.lineTo(x - size, y + a); c.lineTo(x - size, y - a); c.closePath(); }
  else if (shape === "cross") { c.moveTo(x - size, y - size); c.lineTo(x + size, y + size); c.moveTo(x - size, y + size); c.lineTo(x + size, y - size); c.stroke(); return; }
  else { c.arc(x, y, size * 1.1, 0, 7); c.fill(); c.stroke(); if (shape === "dot") { c.beginPath(); c.arc(x, y, size * 0.4, 0, 7); c.fillStyle = token("--ink-2"); c.fill(); c.fillStyle = token("--surface"); } return; }
  c.fill(); c.stroke();
}

function build() {
  plots.forEach((plot) => plot.destroy());
  plots = [];
  for (const id of ["#energy", "#shift", "#time"]) fill($(id), "");
  const total = life.energy_ratio.length, now = life.before + total, { counted, points } = level(), wear = life.wear;
  $("#key-level").textContent = t(`tool.keyLevel.${wear.level?.decides ?? "as_run"}`);
  const warn = ((wear.level?.warning_at ?? 1.07) - 1) * 100, worn = ((wear.level?.worn_at ?? 1.1) - 1) * 100, here = levelPercent(wear), trend = here == null ? null : wear.trend;
  const reach = wear.remaining ? now + Math.min(wear.remaining.high, Math.max(now - life.before, 20) * 1.2) : now;
  const first = life.before, end = Math.max(reach + (reach - first) * 0.06, first + 10), xr = [first - (end - first) * 0.006, end];
  const values = [...counted.map((one) => one[1]), ...points.map((one) => one[1]).filter((value) => value != null)];
  const outside = life.excluded.map((why, i) => why && life.energy_ratio[i] != null ? [numberOf(i), (life.energy_ratio[i] - 1) * 100, why] : null).filter(Boolean);
  const low = Math.min(-3.6, Math.floor(Math.min(0, ...values.length ? [quantile(values, 0.002)] : [0])) - 1), high = Math.max(12.8, Math.ceil(Math.max(0, ...values.length ? [quantile(values, 0.998)] : [0])) + 1);
  const begins = events.findLastIndex((event) => event.kind !== "conditions_confirmed" && !event.revoked_at), marks = events.map((event, i) => ({ ...event, n: i + 1, at: cycleAt(event.at) })).filter((event, i) => i >= begins && event.at >= first && !event.revoked_at);
  const pinned = (u, c) => { for (const one of marks) vline(u, c, one.at, { color: "--ink-3", dash: [1, 3] }); vline(u, c, now, { color: "--ink-2" }); };
  const right = phone() ? 12 : 128;
  if (counted.length || outside.length) plots.push(chart($("#energy"), {
    height: phone() ? 330 : 392, pad: [phone() ? 26 : 42, right, 0, 0], axisX: true, xr, range: () => [low, high], ysplits: () => { const step = high - low > 40 ? 10 : high - low > 22 ? 5 : 2, list = []; for (let value = Math.ceil(low / step) * step; value <= high; value += step) list.push(value); return list; }, left: 44, zoom: false, yvals: (u, list) => list.map((value) => value === 0 ? "0" : signed(value)), xvals: (u, list) => list.map((value) => value < 0 || value % 1 ? "" : num(value)),
    aria: t("tool.chartAria", { level: here == null ? t("unknown") : shownLevel(here), left: wear.remaining ? t("tool.chartLeft", { low: rounded(wear.remaining.low), high: rounded(wear.remaining.high) }) : t("tool.chartNoLeft") }),
    front: (u, c) => {
      const k = dpr();
      c.save(); clip(u);
      const learning = wear.baselines[0];
      if (life.before === 0 && learning?.learnt_from) { c.fillStyle = token("--stage-b"); c.fillRect(X(u, 0.5), u.bbox.top, Math.max(2 * k, X(u, learning.learnt_from + 0.5) - X(u, 0.5)), u.bbox.height); }
      const few = counted.length < 400, radius = few ? 2 : 1.1;
      c.fillStyle = token("--sig-energy"); c.globalAlpha = few ? 0.5 : Math.max(0.14, 90 / Math.sqrt(counted.length * 40));
      for (const [n, value] of counted) c.fillRect(X(u, n) - radius * k, Y(u, value) - radius * k, 2 * radius * k, 2 * radius * k);
      c.globalAlpha = 1; c.strokeStyle = token("--ink-2"); c.lineWidth = k; c.fillStyle = token("--surface");
      for (const [n, value, why] of outside) { c.globalAlpha = hover && hover !== why ? 0.25 : 1; mark(c, X(u, n), Math.min(u.bbox.top + u.bbox.height - 5 * k, Math.max(u.bbox.top + 5 * k, Y(u, value))), shapes[why] ?? "dot", (hover === why ? 4.4 : 3) * k); }
      c.globalAlpha = 1;
      if (trend && here != null) { // the cone is drawn as far as the evidence carries
        const y = (slope) => here + slope * 100 * (end - now);
        c.beginPath(); c.moveTo(X(u, now), Y(u, here)); c.lineTo(X(u, end), Y(u, y(trend.slope_high))); c.lineTo(X(u, end), Y(u, y(trend.slope_low))); c.closePath(); c.fillStyle = token("--sig-energy"); c.globalAlpha = 0.16; c.fill(); c.globalAlpha = 1;
        c.beginPath(); c.moveTo(X(u, now), Y(u, here)); c.lineTo(X(u, end), Y(u, y(trend.slope_per_cycle))); c.strokeStyle = token("--sig-energy"); c.lineWidth = 1.75 * k; c.setLineDash([5 * k, 4 * k]); c.stroke(); c.setLineDash([]);
      }
      levelPath(c, u, points); c.lineJoin = "round"; c.strokeStyle = token("--surface"); c.lineWidth = 5 * k; c.stroke(); c.strokeStyle = token("--sig-energy"); c.lineWidth = 2.4 * k; c.stroke();
      c.restore();
      limit(u, c, 0, phone() ? "" : t("tool.baselineLine"), { color: "--ink-3", dash: [], width: 1 });
      limit(u, c, warn, t("tool.planLine", { value: signed(warn) + NB + "%" }), { color: "--plan", side: "left" });
      limit(u, c, worn, t("tool.wornLine", { value: signed(worn) + NB + "%" }), { color: "--act", dash: [], width: 1.5, bold: true, side: "left" });
      if (wear.remaining) crossing(u, c, now, worn, wear.remaining);
      vline(u, c, now, { color: "--ink-2" });
      if (here != null && !phone()) { c.fillStyle = token("--ink"); c.font = `600 ${12 * k}px ${FONT}`; c.textAlign = "right"; c.textBaseline = "bottom"; halo(c, t("tool.now", { level: shownLevel(here) }), X(u, now) - 7 * k, u.bbox.top + u.bbox.height - 8 * k); }
      eventNames(u, c, marks);
    },
  }));
  $("#charts-none").hidden = plots.length > 0; $("#charts-some").hidden = plots.length === 0;
  // Times and depths compare within one machine, operation and strategy: a line for each, never one through them all.
  const alike = new Map();
  for (let i = 0; i < total; i++) { const key = [life.machine[i], life.operation[i], life.strategy[i]].join("\n"); if (!alike.has(key)) alike.set(key, []); alike.get(key).push(i); }
  const groups = [...alike.values()], needed = Math.max(5, wear.baselines[0]?.needed ?? 5);
  const tracks = (of) => groups.map((places) => ({ x: places.map(numberOf), y: of(places) })).filter((one) => one.y.some((value) => value != null));
  const counts = (value, i) => value == null || life.excluded[i] ? null : value;
  small("#shift", "#shift-title", life.before ? [] : tracks((places) => { const depths = places.map((i) => counts(life.spindle_load_fall_depth_mm[i], i)), base = median(depths.filter((value) => value != null).slice(0, needed)); return depths.map((value) => value == null || base == null ? null : value - base); }), xr, right, "--sig-spindle", t("tool.shift"), pinned, (lowest, highest) => [Math.min(-0.6, lowest), Math.max(2.3, highest)]);
  small("#time", "#time-title", tracks((places) => places.map((i) => { const value = counts(life.duration_ms[i], i); return value == null ? null : value / 1000; })), xr, right, "--ink-2", t("cycle.time"), pinned, (lowest, highest) => { const room = Math.max((highest - lowest) * 0.15, highest * 0.02); return [Math.max(0, lowest - room), highest + room]; });
}
function small(id, title, lines, xr, right, color, name, front, range) {
  const seen = lines.flatMap((one) => one.y.filter((value) => value != null)), there = seen.length > 1;
  $(title).hidden = !there; $(id).hidden = !there;
  if (!there) return;
  const [low, high] = range(quantile(seen, 0.002), quantile(seen, 0.998)), drawn = lines.map((one) => new Track(one.x, { value: one.y }));
  const plot = chart($(id), { height: 92, pad: [8, right, 0, 0], xr, range: () => [low, high], ysplits: () => splits(low, high).filter((_, i) => i % 2 === 0), left: 44, zoom: false, aria: name, front: (u, c) => { front(u, c); for (const track of drawn) line(u, track, "value", { color, width: 1.25 }); } });
  plots.push(plot);
}
const sorted = (values) => [...values].sort((a, b) => a - b);
const quantile = (values, part) => sorted(values)[Math.min(values.length - 1, Math.max(0, Math.round(part * (values.length - 1))))];
const median = (values) => values.length ? sorted(values)[values.length >> 1] : null;
/** The number of the first cycle that began after a time. */
function cycleAt(at) { const when = Date.parse(at); let i = 0; while (i < life.started_at.length && Date.parse(life.started_at[i]) < when) i += 1; return i === 0 ? life.before : numberOf(i) - 1; }
/** Where the level meets the worn line: interval and the likeliest place. */
function crossing(u, c, now, worn, remaining) {
  const k = dpr(), y = Y(u, worn), edge = u.bbox.left + u.bbox.width, a = X(u, now + remaining.low), b = Math.min(edge, X(u, now + remaining.high)), m = X(u, now + remaining.cycles);
  if (a > edge) return;
  c.strokeStyle = token("--ink"); c.lineWidth = 2.5 * k; c.beginPath(); c.moveTo(a, y); c.lineTo(b, y); c.moveTo(a, y - 6 * k); c.lineTo(a, y + 6 * k);
  if (b < edge) { c.moveTo(b, y - 6 * k); c.lineTo(b, y + 6 * k); } else { c.moveTo(edge - 6 * k, y - 5 * k); c.lineTo(edge, y); c.lineTo(edge - 6 * k, y + 5 * k); }
  c.stroke();
  if (m <= edge) { c.fillStyle = token("--surface"); c.beginPath(); c.arc(m, y, 5 * k, 0, 7); c.fill(); c.stroke(); }
  if (!phone()) { const text = t("tool.inCycles", { low: rounded(remaining.low), high: rounded(remaining.high) }); c.fillStyle = token("--ink"); c.font = `600 ${12 * k}px ${FONT}`; const wide = c.measureText(text).width, fits = a + wide < edge; c.textAlign = fits ? "left" : "right"; c.textBaseline = "top"; halo(c, text, fits ? a - 2 * k : edge - 4 * k, y + 14 * k); }
}
function eventNames(u, c, marks) {
  const k = dpr();
  let free = -Infinity;
  for (const one of marks) {
    const x = Math.round(X(u, one.at)) + 0.5;
    vline(u, c, one.at, { color: "--ink-3", dash: [1, 3] });
    c.strokeStyle = token("--ink-3"); c.lineWidth = k; c.beginPath(); c.moveTo(x, u.bbox.top); c.lineTo(x, u.bbox.top - 8 * k); c.stroke();
    c.textBaseline = "bottom"; c.fillStyle = token("--ink-2");
    const name = `${one.n}  ${told("event", one.kind)}`;
    c.font = `${12 * k}px ${FONT}`;
    if (phone() || x < free) { c.font = `600 ${11 * k}px ${FONT}`; c.textAlign = "center"; c.fillText(String(one.n), Math.max(x, u.bbox.left + 4 * k), u.bbox.top - 9 * k); continue; }
    c.textAlign = "left"; c.fillText(name, x - 1, u.bbox.top - 9 * k); c.fillStyle = token("--ink-3"); c.fillText(dayMonth(one.at_time), x - 1, u.bbox.top - 23 * k);
    free = x + c.measureText(name).width + 12 * k;
  }
}

/** Why nothing is told of the wear, in one sentence. */
function unknown(wear) {
  const counted = ["being_counted", "clock_never_set"].filter((code) => wear.reasons.some((one) => one.code === code));
  if (counted.length > 0) return counted.map((code) => told("reason", code, "")).join(" ");
  if (wear.cycles === 0) return t(wear.last_cycle_at ? "tool.saysNewLife" : "tool.saysNoCycle");
  if (isHidden(wear)) return t("tool.saysHidden");
  const reason = wear.reasons.find((one) => one.code === "no_new_tool_baseline") ?? wear.reasons.at(-1);
  const exclusion = told("exclusion", reason?.code, "");
  return t("tool.saysUnknown", { why: exclusion ? t("tool.noneCompared", { why: exclusion }) : told("reason", reason?.code, reason?.message ?? "") });
}
/** The cycles that a level is the median of, as the API counts them for what decides. */
const cyclesOf = (wear) => ({ feed_compensated: wear.feed.compensated_cycles, reference_cycles: wear.feed.reference_cycles }[wear.level.decides] ?? wear.level.n);
const withSd = (found, n) => t(found.sd == null ? "tool.withN" : "tool.withSd", { level: shownLevel((found.value - 1) * 100), sd: num(found.sd * 100, 1), n: num(n) });
/** What is known of the tool and its wear: each figure is the API's field of that name. */
function facts(wear) {
  const [base] = wear.baselines, { level, feed } = wear, known = [
    [t("tool.id"), tool.id], [t("tool.name"), tool.name || t("none")], [t("tool.serial"), tool.serial ?? t("none")], [t("tool.type"), tool.tool_type || t("none")], [t("tool.diameter"), tool.diameter_mm == null ? t("unknown") : unit(tool.diameter_mm, "mm", 1)], [t("tool.life"), num(wear.life)], [t("tool.cyclesLife"), num(wear.cycles)],
  ];
  if (base) {
    known.push([t("tool.machine"), base.machine], [t("tool.operation"), base.operation], [t("tool.baselineEnergy"), base.baseline_joules == null ? t("wear.noBaseline") : unit(base.baseline_joules, "J")], [t("tool.baseline"), t("tool.baselineOf", { learnt: num(base.learnt_from), needed: base.baseline_joules == null ? num(base.needed) : null, basis: t(`basis.${base.basis}`) })]);
    if (base.level_at_entry !== 1) known.push([t("tool.entry"), shownLevel((base.level_at_entry - 1) * 100)]);
  }
  if (level) {
    known.push([t("tool.decides"), t(`tool.decides.${level.decides ?? "nothing"}`)]);
    if (level.decides) known.push([t("tool.level"), withSd(level, cyclesOf(wear))]);
    known.push([t("tool.asRun"), withSd({ value: level.as_run }, level.n)]);
  }
  for (const [key, found, n] of [["tool.compensated", feed.compensated, feed.compensated_cycles], ["tool.atReferenceFeed", feed.at_reference_feed, feed.compensated_cycles], ["tool.byReference", feed.by_reference_cycles, feed.reference_cycles]]) if (found) known.push([t(key), withSd(found, n)]);
  if (feed.references) known.push([t("tool.references"), feed.references.due_in_cycles ? t("tool.referenceIn", { n: num(feed.references.due_in_cycles) }) : t("tool.referenceNow")]);
  return known;
}
function evidence(wear) {
  const left = wear.remaining, [base] = wear.baselines, reasons = Object.entries(wear.excluded), basis = base ? t(`basis.${base.basis}`) : t("unknown"), last = wear.last_cycle_at;
  const ago = last ? age(serverNow() - Date.parse(last), last) : null;
  if (wear.cycles === 0) return ago ? t("tool.evidenceBefore", { age: ago }) : "";
  return [
    left && wear.state !== "worn" ? t("tool.evidenceLeft", { low: rounded(left.low), high: rounded(left.high) }) : null,
    wear.level?.decides ? t(`tool.evidenceOf.${wear.level.decides}`, { n: num(cyclesOf(wear)) }) : null,
    wear.level ? t("tool.evidenceFrom", { counted: num(wear.counted), cycles: num(wear.cycles), basis }) : t("tool.evidenceSoFar", { cycles: num(wear.cycles), basis }),
    reasons.length ? t("tool.evidenceNot", { why: reasons.map(([why, count]) => `${told("exclusion", why)} ${num(count)}`).join(", ") }) : null,
    ago ? t("tool.evidenceLast", { age: ago }) : null,
  ].filter(Boolean).join(" ");
}
function head() {
  const wear = life.wear, here = levelPercent(wear), left = wear.remaining, learning = learnt(wear);
  const sign = { worn: "act", broken_suspected: "act", warning: "plan", changed: "plan" }[wear.state] ?? "note";
  const value = here == null ? null : `${num(Math.abs(here), 1)}${NB}%`;
  const first = wear.state === "worn" ? t("tool.saysWorn", { level: here == null ? "" : shownLevel(here) })
    : wear.state === "broken_suspected" ? t("tool.saysBroken") : wear.state === "changed" ? t("tool.saysChanged")
    : wear.state === "learning" ? t("tool.saysLearning", { have: num(learning?.learnt_from), need: num(learning?.needed), level: here == null ? null : shownLevel(here) })
    : wear.state === "unknown" ? unknown(wear) : here == null ? t("tool.saysHidden")
    : t(here >= 0.05 ? "tool.saysMore" : here <= -0.05 ? "tool.saysLess" : "tool.saysSame", { value, by: t(`tool.by.${wear.level.decides}`) });
  const then = wear.state === "warning" ? (left ? t("tool.changeWithin", { count: rounded(left.cycles) }) : t("tool.planSoon")) : wear.state !== "good" || here == null ? "" : left ? t("tool.leftAbout", { count: rounded(left.cycles) }) : t("tool.tooEarly");
  put($("#say"), html`<span class="${sign === "act" ? "act-ink" : sign === "plan" ? "plan-ink" : ""}">${icon(sign, t(`level.${sign}`))}</span><span>${first} ${then}</span>`);
  const excluded = Object.values(wear.excluded).reduce((sum, count) => sum + count, 0);
  put($("#evidence"), evidence(wear));
  const others = wear.reasons.filter((reason) => ["masked_by_control", "masked_by_feed", "decided_by_compensation", "decided_by_reference_cycles", "level_carried_over", "no_new_tool_baseline", "level_outdated", "cycle_time_risen", "speed_changed", "level_unconfirmed"].includes(reason.code));
  put($("#reasons"), html`${others.map((reason) => notice(reason.code.startsWith("masked_by") || reason.code === "cycle_time_risen" ? "plan" : "", told("reason", reason.code, reason.message)))}`);
  put($("#learning"), learning ? html`<section class="panel body learning"><h2>${t("tool.learning", { have: num(learning.learnt_from), need: num(learning.needed) })}</h2>${progress(learning.learnt_from / learning.needed)}<p class="muted">${t("tool.learningText", { of: [learning.strategy ? told("strategy", learning.strategy) : null, learning.operation, learning.machine].filter(Boolean).join(", "), more: num(Math.max(0, learning.needed - learning.learnt_from)) })}</p></section>` : "");
  put($("#facts"), html`${facts(wear).map(([name, text]) => html`<dt>${name}</dt><dd>${text}</dd>`)}`);
  const counts = Object.entries(wear.excluded);
  $("#out").textContent = excluded ? num(excluded) : "";
  put($("#excluded"), html`${counts.map(([why, count]) => html`<tr tabindex="0" data-why="${why}"><td><svg viewBox="0 0 14 14" width="14" height="14" fill="var(--surface)" stroke="var(--ink-2)" stroke-width="1.4" aria-hidden="true">${trusted(glyphs[shapes[why] ?? "dot"])}</svg></td><th scope="row">${told("exclusion", why)}</th><td class="num">${num(count)}</td></tr>`)}`);
  $("#excluded-none").hidden = counts.length > 0;
  put($("#events"), html`${[...events].map((event, i) => ({ ...event, n: i + 1 })).reverse().map((event) => html`<tr class="${event.revoked_at ? "gone" : ""}"><td class="faint">${event.n}</td><th scope="row">${event.revoked_at ? html`<s>${told("event", event.kind)}</s>` : told("event", event.kind)}${event.reason ? html`<span class="w">${event.reason}</span>` : ""}${event.revoked_at ? html`<span class="w">${t("tool.revoked", { day: dayMonth(event.revoked_at), who: event.revoked_by })}</span>` : may(who, REVOKE) ? html`<button class="btn quiet" data-revoke="${event.id}">${t("tool.revoke")}<span class="sr"> ${event.n}</span></button>` : ""}</th><td class="num faint">${dayMonth(event.at)}</td></tr>`)}`);
  $("#events-none").hidden = events.length > 0;
  const last = life.cycle_id.length - 1;
  $("#next").href = last < 0 ? "/next" : `/next?machine=${segment(life.machine[last])}&operation=${segment(life.operation[last])}&tool=${segment(tool.id)}`;
  $("#last").hidden = last < 0;
  if (last >= 0) $("#last").href = `/cycle?machine=${segment(life.machine[last])}&id=${segment(life.cycle_id[last])}`;
}
function frame() {
  const events_ = "POST /v1/tools/{tool}/events";
  fill($("#main"), html`<div class="head"><div class="titles"><p class="crumbs"><a href="/">${t("nav.fleet")}</a> / ${t("tool.crumb", { id: tool.id })}</p><h1 class="verdict" id="say"></h1><p class="evidence" id="evidence"></p></div>
    <div class="tools"><label class="sr" for="pick">${t("tool.pick")}</label><select id="pick"></select>${action(who, events_, t("tool.recordChange"), { id: "record" })}<a class="btn" id="last">${t("tool.lastCycle")}</a><a class="btn" id="next" href="/next">${t("nav.next")}</a></div></div>
    <div id="said"></div><div id="reasons" class="stack"></div><div id="learning"></div>
    <dialog id="event" aria-labelledby="event-title"><form id="event-form" method="dialog"><h2 id="event-title">${t("tool.recordTitle", { id: tool.id })}</h2><p class="muted">${t("tool.recordText")}</p>
      <label for="event-kind">${t("tool.what")}</label><select id="event-kind">${["changed", "reground", "conditions_confirmed", "mounted_new", "mounted_used", "reset"].map((kind) => html`<option value="${kind}">${told("event", kind)}</option>`)}</select>
      <label for="event-reason">${t("tool.reason")}</label><textarea id="event-reason" rows="3" maxlength="${MOST_REASON}"></textarea><div id="event-said" role="alert"></div>
      <div class="knot-tools"><button class="btn primary" type="submit">${t("save")}</button><button class="btn" type="button" id="event-cancel">${t("cancel")}</button></div></form></dialog>
    <div class="tool-grid"><section class="panel charts-panel" aria-label="${t("tool.charts")}"><div class="key"><span class="strong">${t("tool.energyTitle")}</span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><g fill="var(--sig-energy)" opacity=".65"><rect x="2" y="3" width="2" height="2"/><rect x="8" y="1" width="2" height="2"/><rect x="13" y="4" width="2" height="2"/><rect x="17" y="2" width="2" height="2"/></g></svg>${t("tool.keyCycle")}</span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-energy)" stroke-width="2.6"/></svg><span id="key-level"></span></span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4 20 0v8z" fill="var(--sig-energy)" opacity=".2"/><path d="M0 4h20" stroke="var(--sig-energy)" stroke-width="1.6" stroke-dasharray="5 3"/></svg>${t("tool.keyTrend")}</span>
        <span><svg viewBox="0 0 20 8" aria-hidden="true"><circle cx="6" cy="4" r="3" fill="var(--surface)" stroke="var(--ink-2)"/><path d="M14 1h6v6h-6z" fill="var(--surface)" stroke="var(--ink-2)"/></svg>${t("tool.keyExcluded")}</span></div>
      <p class="muted pad" id="charts-none" hidden>${t("tool.chartsNone")}</p><div id="charts-some"><div id="energy" class="u-wrap"></div><p class="xname tool-x">${t("tool.x")}</p></div>
      <div class="chart-title" id="shift-title"><b>${t("tool.shift")}</b><span>mm</span></div><div id="shift" class="u-wrap"></div>
      <div class="chart-title" id="time-title"><b>${t("cycle.time")}</b><span>s</span></div><div id="time" class="u-wrap"></div></section>
    <aside class="stack" aria-label="${t("tool.about")}">
      <section class="panel"><header><h2>${t("nav.tool")}</h2></header><div class="body"><dl class="facts" id="facts"></dl></div></section>
      <section class="panel"><header><h2>${t("tool.excluded")}</h2><span class="end small" id="out"></span></header><div class="body"><p class="small muted">${t("tool.excludedText")}</p><table class="tight"><thead class="sr"><tr><th scope="col">${t("tool.mark")}</th><th scope="col">${t("tool.reason")}</th><th scope="col">${t("tool.cycles")}</th></tr></thead><tbody id="excluded"></tbody></table><p class="small muted" id="excluded-none" hidden>${t("tool.excludedNone")}</p></div></section>
      <section class="panel"><header><h2>${t("tool.events")}</h2></header><div class="body"><table class="tight"><thead class="sr"><tr><th scope="col">${t("tool.no")}</th><th scope="col">${t("tool.event")}</th><th scope="col">${t("tool.day")}</th></tr></thead><tbody id="events"></tbody></table><p class="small muted" id="events-none" hidden>${t("tool.eventsNone")}</p></div></section>
    </aside></div>`);
  const point = (event) => { const why = event.target.closest?.("tr")?.dataset.why ?? null; if (why !== hover) { hover = why; plots[0]?.redraw(false); } };
  for (const kind of ["pointerover", "focusin"]) $("#excluded").addEventListener(kind, point);
  for (const kind of ["pointerleave", "focusout"]) $("#excluded").addEventListener(kind, () => { hover = null; plots[0]?.redraw(false); });
  $("#pick").addEventListener("change", (event) => location.assign(`/tool?id=${segment(event.target.value)}`));
  $("#events").addEventListener("click", (event) => {
    const number = event.target.closest("[data-revoke]")?.dataset.revoke;
    if (number) confirm({ title: t("tool.revokeTitle"), text: t("tool.revokeText"), label: t("tool.revoke"), work: async () => { await post(`${path()}/events/${number}/revoke`, undefined); await show(); } });
  });
  const dialog = $("#event"), save = $("button[type=submit]", dialog);
  // The same again while no cycle has been run since is most likely a slip, of whoever recorded it.
  const already = (kind) => { const newest = events.findLast((one) => !one.revoked_at); return newest?.kind === kind && !(Date.parse(life.wear.last_cycle_at) > Date.parse(newest.at)) ? newest : null; };
  const record = async (kind) => {
    await post(`${path()}/events`, { kind, reason: oneLine($("#event-reason").value) || null });
    dialog.close();
    $("#event-reason").value = "";
    put($("#said"), notice("", t("tool.recorded")));
    // What is recorded is recorded, also where the page can only read it on its next beat.
    try { await show(); } catch (error) { if (!(error instanceof ApiError)) throw error; }
  };
  $("#record").addEventListener("click", () => { if (!closed($("#record"))) dialog.showModal(); });
  $("#event-cancel").addEventListener("click", () => dialog.close());
  $("#event-form").addEventListener("submit", (event) => {
    event.preventDefault();
    busy(save, async () => {
      fill($("#event-said"), "");
      try {
        const kind = $("#event-kind").value;
        await show();
        const before = already(kind);
        if (before) await confirm({ title: t("tool.againTitle"), text: t("tool.againText", { event: told("event", kind), age: age(serverNow() - Date.parse(before.recorded_at), before.recorded_at) }), label: t("tool.again"), work: () => record(kind) });
        else await record(kind);
      } catch (error) { if (!(error instanceof ApiError)) throw error; fill($("#event-said"), failure(error)); }
    });
  });
}
const path = () => `/v1/tools/${segment(tool.id)}`;
/** The newest cycles put to those that are known; null where they do not go on from them, as after one that came late. */
function joined(tail) {
  const at = tail.before - life.before;
  if (at <= 0) return tail;
  if (tail.wear.life !== life.wear.life || ["machine", "cycle_id", "energy_ratio", "level", "excluded"].some((key) => life[key][at] !== tail[key][0])) return null;
  const drop = Math.max(0, at + tail.cycle_id.length - MOST_CYCLES), columns = Object.keys(tail).filter((key) => Array.isArray(tail[key]));
  return { ...tail, before: life.before + drop, ...Object.fromEntries(columns.map((key) => [key, [...life[key].slice(drop, at), ...tail[key]]])) };
}
/** Asks for the verdict and the events, and for cycles only where one of them differs; says whether anything did. */
async function refresh() {
  const [wear, { items }] = await Promise.all([life ? get(`${path()}/wear`) : null, all(`${path()}/events`, 1000)]);
  const alike = life && JSON.stringify(items) === JSON.stringify(recorded);
  if (alike && JSON.stringify(wear) === JSON.stringify(life.wear)) return false;
  life = (alike && joined(await get(`${path()}/life?last=${TAIL}`))) || await get(`${path()}/life?last=${MOST_CYCLES}`);
  recorded = items;
  events = items.map((event) => ({ ...event, at_time: event.at })).sort((a, b) => Date.parse(a.at) - Date.parse(b.at));
  return true;
}
async function show() {
  const differs = await refresh();
  head(); // ages move on all the same
  if (differs) build();
}
async function pickList() {
  const { items } = await all("/v1/tools", MOST_TOOLS);
  const list = items.map((one) => one.id);
  if (!list.includes(tool.id)) list.unshift(tool.id);
  fill($("#pick"), html`${list.map((id) => html`<option value="${id}" ${id === tool.id ? html`selected` : ""}>${id}</option>`)}`);
}
shell(t("nav.tool"));
fill($("#main"), html`<div class="panel body">${skeleton(6)}</div>`);
await opening(async () => {
  who = await session();
  let id = asked.get("id");
  if (!id) {
    const fleet = await wholeFleet(1), order = { worn: 0, broken_suspected: 1, warning: 2, changed: 3 };
    id = fleet.filter((item) => item.last_cycle).sort((a, b) => (order[a.wear?.state] ?? 9) - (order[b.wear?.state] ?? 9) || (levelPercent(b.wear) ?? -99) - (levelPercent(a.wear) ?? -99))[0]?.last_cycle.tool ?? (await get("/v1/tools?limit=1")).items[0]?.id;
  }
  if (!id) fill($("#main"), html`<section class="panel body">${empty(t("tool.none"), t("tool.noneText"), html`<a class="btn" href="/settings#tools">${t("nav.settings")}</a>`, true)}</section>`);
  else {
    asked.set("id", id);
    tool = await get(`/v1/tools/${segment(id)}`);
    document.title = `${t("tool.crumb", { id })} \u2013 Feedwright`;
    await Promise.all([refresh(), ready()]);
    frame();
    pickList();
    head();
    build();
    const kept = keep(show, BEAT_MS, { least: 5000, drawn: true });
    listen("", { cycle: (event) => { if (event.tool === id) kept.nudge(); }, changed: (event) => { if (event.what === "tools") kept.nudge(); }, gap: kept.nudge });
  }
}, (error) => fill($("#main"), html`<section class="panel body">${error.status === 404 ? empty(t("notfound.title"), t("notfound.text"), html`<a class="btn" href="/">${t("nav.fleet")}</a>`, true) : failure(error, t("error.load"))}</section>`));
