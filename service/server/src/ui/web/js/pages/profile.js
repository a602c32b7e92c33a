import { $, $$, element, fill, html, put } from "../html.js";
import { icon } from "../icons.js";
import { act, busy, closedFor } from "../actions.js";
import { confirm } from "../dialog.js";
import { guard, leave, mayLeave } from "../leave.js";
import { action, closed, shell } from "../shell.js";
import { empty, failure, notice, skeleton } from "../states.js";
import { ApiError, all, ask, get, may, post, segment, session, wholeFleet } from "../api.js";
import { NB, moment, num, signed, unit } from "../format.js";
import { FONT, X, Y, chart, dpr, hatch, limit, line, nice, phone, ready, splits, token } from "../charts.js";
import { Track, forward } from "../track.js";
import { fault, number, numeric, right, wrong, written } from "../fields.js";
import { keep, opening } from "../live.js";
import { language, t, told } from "../text.js";

const asked = new URLSearchParams(location.search);
const BEAT_MS = 15_000, UNDO = 100, PREDICT_MS = 150, KNOTS = 200, GRID = 361;
/** A load at this share of its set load, or a feed at this share of its limit, is held back by it. */
const BINDS = 0.97;
/** Share of the way at feeds that nobody has run, above which a prediction is called a guess. */
const MOST_UNSEEN = 0.5;
const DIALECTS = ["sinumerik", "twincat_nci", "twincat_cnc", "linuxcnc", "fanuc", "heidenhain_afc", "csv", "json"];
const STEPS = ["draft", "shadow", "approved", "active"];
const DRAFT = "POST /v1/feed-profiles";
let names = new Map();
let who = null, row = null, etag = null, versions = [], shown = null, active = null, knots = [], chosen = 0, undo = [], plots = [], base = null, prediction = null, before = null, wanted = 0;
/** Whoever took a step: a name where it is known, else the token's id as the audit has it. */
const person = (by) => by === who.token ? t("profile.you", { name: who.name }) : names.get(by) ?? by;
const at = (list, depth) => { if (depth <= list[0].depth_mm) return list[0].feed_mm_min; for (let i = 1; i < list.length; i++) if (depth <= list[i].depth_mm) { const a = list[i - 1], b = list[i]; return a.feed_mm_min + (b.feed_mm_min - a.feed_mm_min) * (depth - a.depth_mm) / (b.depth_mm - a.depth_mm); } return list.at(-1).feed_mm_min; };
const end = () => knots.at(-1).depth_mm;
const limits = () => shown.content.limits;
const changed = () => JSON.stringify(knots) !== JSON.stringify(shown.content.knots);
/** Fields of the table that hold what no knot may be: they stay as they were typed, and the knots as they were. */
const faults = () => $$("#knots [aria-invalid]");
/** Whether something stands here that no version has. */
const pending = () => changed() || faults().length > 0;
const name = () => changed() ? t("profile.unsaved") : t("profile.version", { n: shown.version });
/** Time along the knots at an override of 100 %, s: the integral of 1/feed over a feed that is linear in depth. */
const duration = (list) => { let s = 0; for (let i = 1; i < list.length; i++) { const a = list[i - 1], b = list[i], way = b.depth_mm - a.depth_mm, rise = b.feed_mm_min - a.feed_mm_min; s += 60 * (Math.abs(rise) < 1e-9 ? way / a.feed_mm_min : way / rise * Math.log(b.feed_mm_min / a.feed_mm_min)); } return s; };
const programmed = (list) => { const x = Array.from({ length: GRID }, (_, i) => list.at(-1).depth_mm * i / (GRID - 1)); return new Track(x, { f: x.map((depth) => at(list, depth)) }); };

/** What the identified load–feed relation says of these knots, on a recorded cycle of the operation. */
async function predict(list) {
  if (!base) return null;
  const answer = await post(`/v1/machines/${segment(base.machine)}/cycles/${segment(base.cycle_id)}/what-if`, { control: { program: { between: "linear", knots: list } }, limits: { feed_drive_percent: limits().feed_drive_load_set_percent, spindle_percent: limits().spindle_load_set_percent }, samples: true });
  const s = answer.predicted_samples, places = forward(s.depth_mm, -1e9), pick = (column) => places.map((i) => column[i]);
  return { answer, track: new Track(pick(s.depth_mm), { fd: pick(s.feed_drive_load_percent), sp: pick(s.spindle_load_percent), f: pick(s.feed_actual_mm_min) }) };
}
let predicting = 0;
/** Predicts soon, and only what was asked for last. */
function predictSoon() {
  clearTimeout(predicting);
  predicting = setTimeout(async () => {
    const mine = ++wanted;
    try {
      const found = await predict(knots);
      if (mine !== wanted) return;
      prediction = found;
      put($("#predict-said"), "");
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (mine !== wanted) return;
      prediction = null;
      put($("#predict-said"), notice("", t("profile.noPrediction"), told("whatif", error.reason ?? "", error.message)));
    }
    paint();
  }, PREDICT_MS);
}
/** Acceleration along the axis that the knots ask for at a depth, mm/s²: v·dv/dz. */
function acceleration(depth) {
  const i = Math.max(1, knots.findIndex((one) => one.depth_mm >= depth - 1e-9)), a = knots[i - 1], b = knots[i];
  return Math.abs(at(knots, depth) / 60 * (b.feed_mm_min - a.feed_mm_min) / 60 / (b.depth_mm - a.depth_mm));
}
/** Runs of depth where something holds the feed back. */
function bindings() {
  const found = [], l = limits();
  for (let i = 0; i < GRID; i++) {
    const depth = end() * i / (GRID - 1), feed = at(knots, depth), fd = prediction?.track.at("fd", depth), sp = prediction?.track.at("sp", depth);
    const why = fd != null && l.feed_drive_load_set_percent && fd >= BINDS * l.feed_drive_load_set_percent && (sp == null || !l.spindle_load_set_percent || fd / l.feed_drive_load_set_percent >= sp / l.spindle_load_set_percent) ? "feed_drive"
      : sp != null && l.spindle_load_set_percent && sp >= BINDS * l.spindle_load_set_percent ? "spindle" : feed >= BINDS * l.feed_max_mm_min ? "machine" : feed <= l.feed_min_mm_min / BINDS ? "slowest" : acceleration(depth) >= BINDS * l.acceleration_mm_s2 ? "acceleration" : null;
    const last = found.at(-1);
    if (why && last?.why === why && last.i === i - 1) { last.to = depth; last.i = i; } else if (why) found.push({ why, from: depth, to: depth, i });
  }
  return found.filter((one) => one.to - one.from > end() / 100);
}
const holds = (depth) => bindings().find((one) => depth >= one.from - 1e-9 && depth <= one.to + 1e-9)?.why ?? null;

function build() {
  plots.forEach((plot) => plot.destroy());
  plots = [];
  for (const id of ["#feed", "#lz", "#lc"]) fill($(id), "");
  const right = phone() ? 12 : 116, xr = [0, end() * 1.02], highest = nice(Math.max(limits().feed_max_mm_min <= 2 * Math.max(...knots.map((one) => one.feed_mm_min)) ? limits().feed_max_mm_min : 0, ...knots.map((one) => one.feed_mm_min), ...(active?.content.knots ?? []).map((one) => one.feed_mm_min)) * 1.08);
  const feed = chart($("#feed"), { height: phone() ? 270 : 264, pad: [8, right, 0, 0], xr, range: () => [0, highest], ysplits: () => splits(0, highest), left: 48, zoom: false, aria: t("profile.feedAria"),
    back: (u, c) => { if (limits().feed_max_mm_min < highest) { c.save(); c.beginPath(); c.rect(u.bbox.left, u.bbox.top, u.bbox.width, Y(u, limits().feed_max_mm_min) - u.bbox.top); c.clip(); c.fillStyle = token("--stage-b"); c.fillRect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); hatch(u, c, "--hatch"); c.restore(); }
      shown.content.sections.forEach((section, i, list) => { if (i % 2 === 0) return; const from = X(u, list[i - 1].to_mm), to = X(u, Math.min(end(), section.to_mm)); c.fillStyle = token("--stage-b"); c.fillRect(from, u.bbox.top, to - from, u.bbox.height); }); },
    front: (u, c) => {
      const k = dpr();
      if (limits().feed_max_mm_min < highest) limit(u, c, limits().feed_max_mm_min, t("profile.fastest"), { width: 1.1 });
      if (active && (active.version !== shown.version || changed())) line(u, programmed(active.content.knots), "f", { color: "--sig-reference", width: 1.25 });
      if (prediction) line(u, prediction.track, "f", { color: "--sig-feed", width: 1.5, dash: [4, 3] });
      line(u, programmed(knots), "f", { color: "--ink", width: 2.25 });
      if (phone()) return;
      c.textAlign = "left"; c.textBaseline = "middle";
      const x = u.bbox.left + u.bbox.width + 8 * k, names = [[name(), Y(u, knots.at(-1).feed_mm_min), "--ink", 600]];
      if (active && (active.version !== shown.version || changed())) names.push([t("profile.activeN", { n: active.version }), Y(u, active.content.knots.at(-1).feed_mm_min), "--ink-3", 400]);
      if (prediction) names.push([t("profile.results"), Y(u, prediction.track.at("f", end() * 0.97) ?? 0), "--sig-feed", 400]);
      names.sort((a, b) => a[1] - b[1]);
      for (let i = 1; i < names.length; i++) if (names[i][1] - names[i - 1][1] < 15 * k) names[i][1] = names[i - 1][1] + 15 * k;
      for (const [text, y, color, weight] of names) { c.font = `${weight} ${12 * k}px ${FONT}`; c.fillStyle = token(color); c.fillText(text, x, y); }
    },
    // Knobs have their places once the scales are there, not when the prediction is.
    onReady: () => queueMicrotask(place), onSize: () => place() });
  const load = (id, key, color, set, axisX, title) => {
    const top = () => nice(Math.max(20, (set ?? 0) * 1.25, ...[prediction, before].map((one) => one?.track.extremes(key, 0, one.track.x.length)?.[1] ?? 0)) * 1.02);
    const plot = chart($(id), { height: 104 + (axisX ? 30 : 0), pad: [8, right, 0, 0], xr, range: () => [0, top()], ysplits: () => { const list = splits(0, top()); return list.length > 4 ? list.filter((_, n) => n % 2 === 0) : list; }, left: 48, zoom: false, axisX, aria: title, front: (u, c) => {
      if (before) line(u, before.track, key, { color: "--sig-reference", width: 1.25, dash: [4, 3] });
      if (prediction && set != null) over(u, c, prediction.track, key, set);
      if (prediction) line(u, prediction.track, key, { color, width: 1.9, dash: [5, 3] });
      if (set != null) limit(u, c, set, `L_set ${num(set)}${NB}%`);
    } });
    plot.fit = () => plot.setScale("y", { min: 0, max: top() });
    return plot;
  };
  plots = [feed, load("#lz", "fd", "--sig-feed-drive", limits().feed_drive_load_set_percent, false, t("cycle.feedDrive")), load("#lc", "sp", "--sig-spindle", limits().spindle_load_set_percent, true, t("cycle.spindle"))];
  knots.forEach((_, i) => plots[0].over.append(knob(i)));
  paint();
}
/** What lies over a limit is filled: the only warm area of the page. */
function over(u, c, track, key, set) {
  const y = Y(u, set);
  c.save(); c.beginPath(); c.rect(u.bbox.left, u.bbox.top, u.bbox.width, y - u.bbox.top); c.clip();
  c.beginPath(); c.moveTo(X(u, track.x[0]), y);
  track.each(key, track.x[0], track.x[track.x.length - 1], Math.round(u.bbox.width), (x, low, high) => { if (!Number.isNaN(high)) c.lineTo(X(u, x), Y(u, Math.max(high, set))); });
  c.lineTo(X(u, track.x[track.x.length - 1]), y); c.closePath(); c.fillStyle = token("--act"); c.globalAlpha = 0.85; c.fill(); c.restore();
}
function knob(i) {
  if (phone()) return element(html`<span class="knob" aria-hidden="true"></span>`); // on a phone the numbers below are edited
  let moved = false;
  const button = element(html`<button class="knob" role="slider" aria-orientation="vertical"></button>`);
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); event.stopPropagation(); button.setPointerCapture(event.pointerId); button.focus(); chosen = i; moved = false; marks(); place(); });
  button.addEventListener("mousedown", (event) => event.stopPropagation());
  button.addEventListener("pointermove", (event) => { if (!button.hasPointerCapture(event.pointerId)) return; if (!moved) { moved = true; remember(); } const rect = plots[0].over.getBoundingClientRect(); move(i, snapped(plots[0].posToVal(event.clientX - rect.left, "x"), 10), snapped(plots[0].posToVal(event.clientY - rect.top, "y"), 1 / 5)); });
  button.addEventListener("keydown", (event) => { const size = event.shiftKey ? 10 : 1, step = { ArrowUp: [0, 5 * size], ArrowDown: [0, -5 * size], ArrowLeft: [-0.1 * size, 0], ArrowRight: [0.1 * size, 0] }[event.key]; if (!step) return; event.preventDefault(); chosen = i; remember(); move(i, step[0] ? snapped(knots[i].depth_mm + step[0], 10) : null, step[1] ? snapped(knots[i].feed_mm_min + step[1], 1 / 5) : null); });
  button.addEventListener("focus", () => { chosen = i; marks(); place(); });
  return button;
}
function remember() { undo.push(structuredClone(knots)); if (undo.length > UNDO) undo.shift(); }
/** The nearest of so many steps in a unit: what is drawn by hand is no finer. */
const snapped = (value, steps) => Math.round(value * steps) / steps;
/** Drags a knot somewhere between its neighbours and within the limits; what is null stays, and the ends keep their depth. */
function move(i, depth, feed) {
  const { depth_mm, feed_mm_min } = knots[i], last = knots.length - 1;
  let z = depth_mm;
  if (depth != null && i > 0 && i < last) {
    const low = snapped(knots[i - 1].depth_mm + 0.1, 10), high = snapped(knots[i + 1].depth_mm - 0.1, 10);
    // Between neighbours that were typed closer than a step there is nowhere to drag to.
    if (low < high || (low === high && low > knots[i - 1].depth_mm && low < knots[i + 1].depth_mm)) z = Math.min(high, Math.max(low, depth));
  }
  knots[i] = { depth_mm: z, feed_mm_min: feed == null ? feed_mm_min : Math.min(limits().feed_max_mm_min, Math.max(limits().feed_min_mm_min, feed)) };
  // What was typed into what is dragged now is over.
  const [ofDepth, ofFeed] = $$("input", $$("#knots tr")[i]);
  if (z !== depth_mm) clear(ofDepth);
  if (feed != null) clear(ofFeed);
  again();
  paint();
  predictSoon();
}
/** What is wrong with a field of the table, null where nothing is. */
function refusal(i, name, input) {
  const bad = fault(input, true);
  if (bad) return bad;
  const value = number(input.value), l = limits();
  if (name === "feed_mm_min") return value < l.feed_min_mm_min || value > l.feed_max_mm_min ? t("profile.feedBetween", { low: unit(l.feed_min_mm_min, "mm/min", decimals(l.feed_min_mm_min)), high: unit(l.feed_max_mm_min, "mm/min", decimals(l.feed_max_mm_min)) }) : null;
  const low = knots[i - 1].depth_mm, high = knots[i + 1].depth_mm;
  return value <= low || value >= high ? t("profile.depthBetween", { low: unit(low, "mm", decimals(low)), high: unit(high, "mm", decimals(high)) }) : null;
}
const decimals = (value) => Math.min(6, (String(value).split(".")[1] ?? "").length);
function mark(input, why) { wrong(input, null, why); input.title = why; input.setAttribute("aria-describedby", "knots-said"); }
function clear(input) { right(input); input.removeAttribute("title"); }
const NAMES = ["depth_mm", "feed_mm_min"];
/** Takes a field of the table exactly as it was typed, or marks it and leaves the knot as it was. */
function accept(i, name, input) {
  const why = refusal(i, name, input);
  if (why) { mark(input, why); return false; }
  clear(input);
  knots[i] = { ...knots[i], [name]: number(input.value) };
  return true;
}
/** Looks again at what was refused: another knot has moved, and it may be right now. */
function again() {
  for (let taken = true; taken;) taken = $$("#knots tr").some((tr, i) => $$("input", tr).some((input, n) => input.hasAttribute("aria-invalid") && refusal(i, NAMES[n], input) == null && accept(i, NAMES[n], input)));
}
const placeOf = (input) => { const tr = input.closest("tr"); return [[...tr.parentNode.children].indexOf(tr), NAMES[$$("input", tr).indexOf(input)]]; };
/** A field of the table was changed by hand. */
function typed(input) {
  const [i, name] = placeOf(input), before = structuredClone(knots);
  chosen = i;
  accept(i, name, input);
  again();
  if (JSON.stringify(before) !== JSON.stringify(knots)) { undo.push(before); if (undo.length > UNDO) undo.shift(); predictSoon(); }
  paint();
  stepper();
}
/** The arrow keys step in the table as they do on a knob: up and down, by a step of what the field holds. */
function stepped(event) {
  const up = { ArrowUp: 1, ArrowDown: -1 }[event.key], input = event.target, [i, name] = placeOf(input);
  if (!up || input.readOnly) return;
  event.preventDefault();
  if (number(input.value) !== knots[i][name]) typed(input);
  if (input.hasAttribute("aria-invalid")) return;
  const by = up * (event.shiftKey ? 10 : 1);
  chosen = i;
  remember();
  if (name === "depth_mm") move(i, snapped(knots[i].depth_mm + by / 10, 10), null); else move(i, null, snapped(knots[i].feed_mm_min + 5 * by, 1 / 5));
  input.value = written(knots[i][name]);
  stepper();
}
function faultsSaid() {
  const list = faults();
  put($("#knots-said"), list.length ? html`<p class="flag act">${icon("act")}<span>${t("profile.wrong")}</span></p><ul class="field-errors">${list.map((input) => html`<li>${t("profile.wrongKnot", { n: placeOf(input)[0] + 1, why: input.title })}</li>`)}</ul>` : "");
}
function place() {
  $$(".knob", plots[0].over).forEach((button, i) => {
    button.style.left = `${plots[0].valToPos(knots[i].depth_mm, "x")}px`;
    button.style.top = `${plots[0].valToPos(knots[i].feed_mm_min, "y")}px`;
    button.classList.toggle("on", i === chosen);
    if (phone()) return;
    button.setAttribute("aria-label", t("profile.knotAt", { n: i + 1, depth: unit(knots[i].depth_mm, "mm", Math.max(1, decimals(knots[i].depth_mm))) }));
    button.setAttribute("aria-valuemin", limits().feed_min_mm_min); button.setAttribute("aria-valuemax", limits().feed_max_mm_min); button.setAttribute("aria-valuenow", knots[i].feed_mm_min); button.setAttribute("aria-valuetext", unit(knots[i].feed_mm_min, "mm/min", decimals(knots[i].feed_mm_min)));
  });
  const host = $("#ribbon"), u = plots[0];
  const runs = bindings().map((one) => { const from = u.valToPos(one.from, "x"); return { one, from, wide: u.valToPos(one.to, "x") - from, text: t(`profile.held.${one.why}`) }; });
  host.replaceChildren(...runs.map(({ from, wide, text }, i) => {
    // A run that is too short for its name has it beside it, where there is room before the next one.
    const node = element(html`<span class="seg-l" title="${text}"><span>${text}</span></span>`), long = text.length * 6 + 8, room = (runs[i + 1]?.from ?? u.over.clientWidth) - from - wide;
    node.style.left = `${u.over.offsetLeft + from}px`;
    node.style.width = `${wide}px`;
    if (wide < long) node.classList.add(room > long ? "short" : "unnamed");
    return node;
  }));
}
function marks() { $$("#knots tr").forEach((tr, i) => tr.classList.toggle("on", i === chosen)); put($("#remove"), t("profile.remove", { n: chosen + 1 })); $("#remove").disabled = chosen === 0 || chosen === knots.length - 1; }
function paint() {
  if (plots.length === 0) return;
  if ($$(".knob", plots[0].over).length !== knots.length) { $$(".knob", plots[0].over).forEach((one) => one.remove()); knots.forEach((_, i) => plots[0].over.append(knob(i))); rows(); }
  for (const plot of plots) { plot.fit?.(); plot.redraw(false, true); }
  place();
  $$("#knots tr").forEach((tr, i) => { const [z, f] = $$("input", tr); for (const [input, value] of [[z, knots[i].depth_mm], [f, knots[i].feed_mm_min]]) if (document.activeElement !== input && !input.hasAttribute("aria-invalid") && number(input.value) !== value) input.value = written(value); const why = holds(knots[i].depth_mm); put($(".why", tr), why ? t(`profile.held.${why}`) : html`<span class="faint">${t("profile.free")}</span>`); });
  marks();
  figures();
  trust();
  difference();
  faultsSaid();
  const bad = faults().length > 0, allowed = may(who, "POST /v1/feed-profiles");
  // A row that comes or goes would take along what was typed and is not taken yet.
  $("#add").disabled = bad;
  if (bad) $("#remove").disabled = true;
  $("#undo").disabled = undo.length === 0 && !bad;
  $("#save").setAttribute("aria-disabled", String(!changed() || bad || !allowed));
  if (allowed) $("#save").title = bad ? t("profile.wrong") : changed() ? "" : t("profile.nothingChanged");
}
function figures() {
  const now = prediction?.answer.predicted, then = before?.answer.predicted, against = active && active.version !== shown.version || changed() ? (active ?? shown) : null;
  const versus = (value, other, digits) => against && value != null && other != null ? t("profile.against", { change: signed(value - other, digits), n: against.version }) : "";
  const l = limits(), items = [
    [t("profile.time"), duration(knots), "s", 2, against ? versus(duration(knots), duration(against.content.knots), 2) : ""],
    [t("profile.energy"), now?.energy_j, "J", 0, versus(now?.energy_j, then?.energy_j, 0)],
    [t("cycle.highestFeedDrive"), now?.peak_feed_drive_percent, "%", 1, l.feed_drive_load_set_percent == null ? "" : t("cycle.limit", { value: `${num(l.feed_drive_load_set_percent)}${NB}%` }), now?.peak_feed_drive_percent > l.feed_drive_load_set_percent],
    [t("cycle.highestSpindle"), now?.peak_spindle_percent, "%", 1, l.spindle_load_set_percent == null ? "" : t("cycle.limit", { value: `${num(l.spindle_load_set_percent)}${NB}%` }), now?.peak_spindle_percent > l.spindle_load_set_percent],
    [t("cycle.timeOver"), now?.overload_s, "s", 2, versus(now?.overload_s, then?.overload_s, 2)],
    [t("profile.holdsTo"), (shown.content.wear.to_level - 1) * 100, "%", 1, t("profile.holdsWhat")]];
  put($("#figures"), html`${items.map(([title, value, un, digits, vs, warm]) => html`<div><dt title="${title}">${title}</dt><dd>${value == null ? html`<span class="faint">${t("unknown")}</span>` : html`${num(value, digits)} <span class="unit">${un}</span>`}</dd><dd class="vs ${warm ? "plan" : ""}">${warm ? `${t("cycle.over")} ` : ""}${vs || "\u00a0"}</dd></div>`)}`);
}
function difference() {
  const other = changed() ? shown : active && active.version !== shown.version ? active : versions.find((one) => one.version === shown.based_on);
  $("#diff-title").textContent = other ? t("profile.diffTitle", { a: name(), b: other.version }) : t("profile.diff");
  if (!other) { put($("#diff"), ""); put($("#moved"), ""); $("#diff-none").hidden = false; return; }
  const feed = (one, list, z) => one ? num(one.feed_mm_min, decimals(one.feed_mm_min)) : num(at(list, z));
  const depths = [...new Set([...knots, ...other.content.knots].map((one) => one.depth_mm))].sort((a, b) => a - b), has = (list, z) => list.find((one) => one.depth_mm === z), lines = [];
  for (const z of depths) { const a = has(other.content.knots, z), b = has(knots, z); if (a && b && a.feed_mm_min === b.feed_mm_min) continue; lines.push([z, a, b]); }
  put($("#diff"), html`${lines.map(([z, a, b]) => html`<tr><th scope="row" class="num">${num(z, Math.max(1, decimals(z)))}</th><td>${a ? b ? t("profile.moved") : t("profile.removed") : t("profile.added")}</td><td class="num"><s>${feed(a, other.content.knots, z)}</s></td><td class="num"><b>${feed(b, knots, z)}</b></td></tr>`)}`);
  put($("#moved"), t("of", { a: num(lines.length), b: num(Math.max(knots.length, other.content.knots.length)) }));
  $("#diff-none").hidden = lines.length > 0;
}
function rows() {
  fill($("#knots"), html`${knots.map((one, i) => html`<tr><th scope="row">${i + 1}</th><td class="num">${numeric(null, one.depth_mm, html`aria-label="${t("profile.depthOf", { n: i + 1 })}" ${i === 0 || i === knots.length - 1 ? html`readonly` : ""}`)}</td><td class="num">${numeric(null, one.feed_mm_min, html`aria-label="${t("profile.feedOf", { n: i + 1 })}"`)}</td><td class="why"></td></tr>`)}`);
}
function stepper() {
  const order = STEPS.indexOf(shown.state);
  put($("#steps"), html`${shown.state === "superseded" ? html`<li class="done" aria-current="step">${t("profile.state.superseded")}</li>` : STEPS.map((step, i) => html`<li class="${i <= order ? "done" : ""}" ${i === order ? html`aria-current="step"` : ""}>${t(`profile.state.${step}`)}</li>`)}`);
  const own = shown.drafted.by === who.token;
  const can = { shadow: shown.state === "draft", approve: shown.state === "shadow" && !own, activate: shown.state === "approved" || shown.state === "superseded", rollback: row.active_version != null && row.active_version === shown.version };
  const why = { shadow: shown.state === "draft" ? null : t("profile.onlyDraft"), approve: shown.state !== "shadow" ? t("profile.onlyShadow") : own ? t("profile.ownDraft") : null, activate: can.activate ? null : t("profile.onlyApproved"), rollback: can.rollback ? null : t("profile.onlyActive") };
  const primary = shown.state === "draft" ? "shadow" : shown.state === "shadow" ? "approve" : shown.state === "approved" ? "activate" : null;
  const closedSteps = new Map(), moves = ["shadow", "approve", "activate", "rollback"].map((step) => {
    const route = `POST /v1/feed-profiles/{profile}/${step}`, mine = may(who, route), free = can[step] && mine && !pending(), reason = !mine ? closedFor(who.role, route) : pending() ? t("profile.saveFirst") : why[step];
    if (!free) closedSteps.set(reason, [...closedSteps.get(reason) ?? [], t(`profile.do.${step}`)]);
    return html`<button class="btn ${free && step === primary ? "primary" : ""}" value="${step}" ${free ? "" : html`aria-disabled="true" title="${reason}" aria-description="${reason}"`}>${t(`profile.do.${step}`)}</button>`;
  });
  put($("#moves"), html`${moves}`);
  if (!may(who, DRAFT)) closedSteps.set(closedFor(who.role, DRAFT), [...closedSteps.get(closedFor(who.role, DRAFT)) ?? [], t("profile.optimise"), t("profile.saveDraft")]);
  else if (!pending()) closedSteps.set(t("profile.nothingChanged"), [t("profile.saveDraft")]);
  // A title is seen by a mouse only: what is closed says so in words.
  put($("#gate"), html`${{ draft: t("profile.gateDraft"), shadow: t("profile.gateShadow"), approved: t("profile.gateApproved") }[shown.state] ?? ""}${[...closedSteps].map(([reason, names]) => html`<span class="w">${names.join(", ")}: ${reason}</span>`)}`);
  put($("#title"), t("profile.title", { id: row.id, n: shown.version, state: language === "en" ? t(`profile.state.${shown.state}`).toLowerCase() : t(`profile.state.${shown.state}`) }));
  put($("#about"), [shown.reason, t("profile.by", { who: person(shown.drafted.by), time: moment(shown.drafted.at) }), shown.shadowed ? t("profile.shadowedBy", { who: person(shown.shadowed.by), time: moment(shown.shadowed.at) }) : null, shown.approved ? t("profile.approvedBy", { who: person(shown.approved.by), time: moment(shown.approved.at) }) : null, shown.activated ? t("profile.activatedBy", { who: person(shown.activated.by), time: moment(shown.activated.at) }) : null].filter(Boolean).join(". ") + ".");
  put($("#versions"), html`${[...versions].reverse().map((one) => html`<tr class="${one.state}"><th scope="row">${one.version}</th><td><span class="tag ${one.state === "active" ? "solid" : ""}">${t(`profile.state.${one.state}`)}</span></td><td><span class="t">${one.reason}</span><span class="w">${t(`profile.source.${one.source}`)}, ${unit(one.time_s, "s", 2)}${[["drafted", "by"], ["approved", "approvedBy"], ["activated", "activatedBy"]].filter(([step]) => one[step]).map(([step, key]) => html`<br>${t(`profile.${key}`, { who: person(one[step].by), time: moment(one[step].at) })}`)}</span></td><td class="num">${one.version === shown.version ? html`<span class="faint">${t("profile.shown")}</span>` : html`<a class="btn quiet" href="/profile?id=${segment(row.id)}&amp;version=${one.version}">${t("profile.show")}</a>`}</td></tr>`)}`);
  const released = ["approved", "active", "superseded"].includes(shown.state);
  $("#dialect").disabled = !released;
  put($("#nc-note"), released ? "" : t("profile.notReleased"));
  $("#nc").hidden = !released; $("#download").hidden = !released; if (released) file();
}
async function file() {
  const dialect = $("#dialect").value, path = `/v1/feed-profiles/${segment(row.id)}/export?dialect=${dialect}&version=${shown.version}`;
  $("#download").href = path;
  let text = "", note = "";
  try { text = await get(path, { text: true }); } catch (error) { if (!(error instanceof ApiError)) throw error; note = failure(error); }
  if ($("#download").getAttribute("href") !== path) return; // another one is wanted by now
  put($("#nc"), text);
  put($("#nc-note"), note);
}
/** Where rolling back leads to: what was in force last and was not rolled back itself, null where nothing was. */
const backTo = () => versions.filter((one) => one.state === "superseded" && !one.rolled_back).sort((a, b) => Date.parse(b.activated.at) - Date.parse(a.activated.at))[0] ?? null;
/** What a step changes for the machines, before it is taken. */
function changes(step) {
  const then = { approve: active, activate: shown, rollback: backTo() }[step], of = { n: then?.version, operation: row.operation, type: row.tool_type };
  const says = (one) => one ? t("profile.versionSays", { n: one.version, why: one.reason }) : t("profile.noVersion");
  return html`<dl class="facts"><dt>${t("profile.inForce")}</dt><dd>${says(active)}</dd><dt>${t("profile.willBe")}</dt><dd>${says(then)}</dd></dl><p class="muted">${step === "approve" ? t("profile.tellsNothing") : then ? t("profile.tells", of) : t("profile.tellsNone", of)}</p>`;
}
async function take(step, button) {
  // Of what is shown now, and of nothing that comes meanwhile.
  const failed = t("profile.notDone", { step: t(`profile.do.${step}`) }), { version } = shown, held = etag;
  let late = false;
  const go = async () => {
    try { await ask("POST", `/v1/feed-profiles/${segment(row.id)}/${step}`, { body: step === "rollback" ? undefined : { version }, etag: held }); } catch (error) { late = error.status === 412; throw error; }
  };
  // A shadow is computed and told nobody; the rest is asked for again, with what it does.
  if (step === "shadow") await busy(button, async () => { try { await go(); await moved(t("profile.did.shadow", { n: version })); } catch (error) { if (!(error instanceof ApiError)) throw error; if (!late) fill($("#said"), failure(error, failed)); } });
  else if (await confirm({ title: t(`profile.sure.${step}`, { n: version, id: row.id }), text: changes(step), label: t(`profile.do.${step}`), work: go, failed })) await moved(t(`profile.did.${step}`, { n: version }));
  if (late) await moved(t("profile.movedOn"));
}
/** Shows where the profile stands after a step. What was done is told also where it cannot be read just now. */
async function moved(what, version = shown.version) {
  let late = "";
  try { await load(row.id, version); undo = []; begin(); } catch (error) { if (!(error instanceof ApiError)) throw error; late = failure(error, t("error.load")); }
  fill($("#said"), html`${notice("", what)}${late}`);
}
async function save(reason) {
  return (await post("/v1/feed-profiles", { profile: row.id, content: { ...shown.content, knots }, based_on: shown.version, reason })).version;
}
async function optimise() {
  const id = row?.id ?? $("#o-name").value.trim(), operation = row?.operation ?? $("#o-operation").value, tool_type = row?.tool_type ?? $("#o-type").value.trim();
  if (!row && !tool_type) { fill($("#said"), notice("plan", t("profile.noToolType"), t("profile.noToolTypeText"))); return; }
  fill($("#said"), html`<p class="muted" role="status">${t("profile.optimising")}</p>`);
  try {
    const found = (await get(`/v1/operations/${segment(operation)}`)), machine = base ? await get(`/v1/machines/${segment(base.machine)}`) : (await get("/v1/machines?limit=1")).items[0];
    if (!machine) { fill($("#said"), notice("plan", t("profile.noMachine"), t("profile.noMachineText"))); return; }
    const l = row && shown ? limits() : { ...machine.limits, spindle_load_set_percent: found.spindle_load_set_percent, feed_drive_load_set_percent: found.feed_drive_load_set_percent };
    const started = await ask("POST", "/v1/feed-profiles/optimize", { body: { operation, tool_type, ...(row ? { profile: row.id } : {}), limits: l } });
    let job = started.body;
    while (job.state === "waiting" || job.state === "running") { await new Promise((wake) => setTimeout(wake, 400)); job = await get(`/v1/jobs/${job.id}`); }
    if (job.state !== "done" || !job.result?.content) { const why = job.result?.refused?.[0]?.message ?? job.result?.report?.reason ?? job.result?.reason ?? job.result?.why ?? job.state; fill($("#said"), notice("plan", t("profile.noProposal"), typeof why === "string" ? why : JSON.stringify(why).slice(0, 400))); return; }
    const answer = await post("/v1/feed-profiles", { profile: id, job: job.id, reason: t("profile.optimisedFrom"), ...(row ? { based_on: shown.version } : {}) });
    const address = `/profile?id=${segment(id)}&version=${answer.version}`;
    // It took a while: what was moved meanwhile stays, if it is to.
    if (await mayLeave()) leave(address); else fill($("#said"), notice("", t("profile.saved", { n: answer.version }), null, html`<a href="${address}">${t("profile.show")}</a>`));
  } catch (error) { if (!(error instanceof ApiError)) throw error; fill($("#said"), failure(error)); }
}
async function reasonDialog() {
  let version = null;
  if (await confirm({ title: t("profile.saveTitle"), text: t("profile.saveText"), reason: t("profile.why"), label: t("profile.saveDraft"), failed: t("profile.notSaved"), work: async (reason) => { version = await save(reason); } })) {
    knots = structuredClone(shown.content.knots);
    await moved(t("profile.saved", { n: version }), version);
  }
}
function frame(lines) {
  fill($("#main"), html`<div class="head"><div class="titles"><p class="crumbs"><a href="/profile">${t("profile.all")}</a> / ${row.operation} / ${row.tool_type}</p><h1 id="title"></h1><ol class="steps" id="steps" aria-label="${t("profile.stateOf")}"></ol><p class="evidence" id="about"></p></div>
      <div class="tools"><label class="sr" for="line">${t("profile.other")}</label><select id="line">${lines.map((one) => html`<option value="${one.id}" ${one.id === row.id ? html`selected` : ""}>${one.id}</option>`)}</select><button class="btn quiet" id="undo">${icon("undo")}${t("profile.undo")}</button>${action(who, "POST /v1/feed-profiles/optimize", t("profile.optimise"), { id: "optimise" })}${action(who, "POST /v1/feed-profiles", t("profile.saveDraft"), { id: "save" })}<span id="moves" class="moves"></span><p class="gate" id="gate"></p></div></div>
    <div id="said"></div><div id="predict-said"></div><dl class="figures six" id="figures"></dl>
    <div class="prof-grid"><section class="panel charts-panel" aria-label="${t("profile.charts")}"><div class="key"><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--ink)" stroke-width="2.4"/><circle cx="10" cy="4" r="3.4" fill="var(--surface)" stroke="var(--ink)" stroke-width="1.6"/></svg><em>${t("profile.keyDraft")}<em class="prof-only-wide">${t("profile.keyDrag")}</em></em></span><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-reference)" stroke-width="1.6"/></svg>${t("profile.keyActive")}</span><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-limit)" stroke-width="1.6" stroke-dasharray="5 3"/></svg>${t("profile.keyDashed")}</span></div>
        <div class="row"><div class="chart-title"><b>${t("cycle.feed")}</b><span>mm/min</span></div><div id="feed" class="u-wrap"></div></div><div class="row"><div class="chart-title"><b>${t("profile.heldBy")}</b></div><div id="ribbon" class="ribbon"></div></div><div class="row"><div class="chart-title"><b>${t("cycle.feedDrive")}</b><span>${t("profile.predicted")}</span></div><div id="lz" class="u-wrap"></div></div><div class="row"><div class="chart-title"><b>${t("cycle.spindle")}</b><span>${t("profile.predicted")}</span></div><div id="lc" class="u-wrap"></div></div><p class="xname">${t("cycle.xDepth")}</p></section>
      <section class="panel" aria-label="${t("profile.knots")}"><header><h2>${t("profile.knots")}</h2></header><div class="body"><div class="knots-scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="tight knots"><thead><tr><th scope="col">${t("tool.no")}</th><th scope="col" class="num">${t("cycle.depthMm")}</th><th scope="col" class="num">${t("cycle.feed")}, mm/min</th><th scope="col">${t("profile.heldBy")}</th></tr></thead><tbody id="knots"></tbody></table></div><div id="knots-said" role="alert"></div><div class="knot-tools"><button class="btn" id="add">${t("profile.add")}</button><button class="btn" id="remove"></button></div><p class="small muted" id="based"></p><div id="trust"></div></div></section></div>
    <div class="prof-low"><section class="panel"><header><h2>${t("profile.versions")}</h2></header><div class="body"><table class="tight versions"><thead class="sr"><tr><th scope="col">${t("set.version")}</th><th scope="col">${t("col.state")}</th><th scope="col">${t("profile.why")}</th><th scope="col">${t("set.do")}</th></tr></thead><tbody id="versions"></tbody></table></div></section>
      <section class="panel"><header><h2 id="diff-title"></h2><span class="end tiny faint" id="moved"></span></header><div class="body"><table class="tight"><thead><tr><th scope="col" class="num">${t("cycle.depthMm")}</th><th scope="col">${t("profile.change")}</th><th scope="col" class="num" colspan="2">${t("cycle.feed")}, mm/min</th></tr></thead><tbody id="diff"></tbody></table><p class="small muted" id="diff-none" hidden>${t("profile.same")}</p></div></section>
      <section class="panel"><header><h2>${t("profile.program")}</h2><span class="end"><label class="sr" for="dialect">${t("profile.control")}</label><select id="dialect">${DIALECTS.map((one) => html`<option value="${one}">${t(`dialect.${one}`)}</option>`)}</select></span></header><div class="body"><pre class="nc" id="nc" tabindex="0" role="region" aria-label="${t("profile.program")}"></pre><div id="nc-note" class="small muted"></div><p><a class="btn" id="download" hidden download>${icon("download")}${t("profile.download")}</a></p></div></section></div>`);
  $("#line").addEventListener("change", async ({ target }) => { if (await mayLeave()) leave(`/profile?id=${segment(target.value)}`); else target.value = row.id; });
  $("#undo").addEventListener("click", () => {
    // What was refused is what was done last: the knots themselves are as they were before it.
    const last = faults().length ? knots : undo.pop();
    if (last) { knots = last; chosen = Math.min(chosen, knots.length - 1); rows(); paint(); predictSoon(); stepper(); }
  });
  $("#optimise").addEventListener("click", async ({ currentTarget: button }) => { if (!closed(button) && await mayLeave()) busy(button, optimise); });
  $("#save").addEventListener("click", () => { if (!closed($("#save"))) reasonDialog(); });
  $("#moves").addEventListener("click", (event) => { const button = event.target.closest("button"); if (button && !closed(button)) take(button.value, button); });
  $("#add").addEventListener("click", () => { if (knots.length >= KNOTS) return; const i = Math.min(chosen, knots.length - 2), a = knots[i], b = knots[i + 1], z = Math.round((a.depth_mm + b.depth_mm) * 5) / 10; if (z <= a.depth_mm || z >= b.depth_mm) return; remember(); knots.splice(i + 1, 0, { depth_mm: z, feed_mm_min: Math.round(at(knots, z) / 5) * 5 }); chosen = i + 1; rows(); paint(); predictSoon(); stepper(); });
  $("#remove").addEventListener("click", () => { if (chosen === 0 || chosen === knots.length - 1) return; remember(); knots.splice(chosen, 1); chosen = Math.max(0, chosen - 1); rows(); paint(); predictSoon(); stepper(); });
  $("#knots").addEventListener("change", (event) => typed(event.target));
  $("#knots").addEventListener("keydown", stepped);
  // What is marked is told anew while it is typed: one reason may have become another.
  $("#knots").addEventListener("input", ({ target }) => { if (!target.hasAttribute("aria-invalid")) return; const why = refusal(...placeOf(target), target); if (why) { mark(target, why); faultsSaid(); } });
  $("#knots").addEventListener("focusin", (event) => { const tr = event.target.closest("tr"); if (tr) { chosen = [...tr.parentNode.children].indexOf(tr); marks(); place(); } });
  $("#feed").addEventListener("pointerup", stepper); $("#feed").addEventListener("keyup", stepper);
  $("#dialect").addEventListener("change", file);
}
async function load(id, version) {
  const [found, list] = await Promise.all([ask("GET", `/v1/feed-profiles/${segment(id)}`), all(`/v1/feed-profiles/${segment(id)}/versions`, 500)]);
  row = found.body; etag = found.etag; versions = list.items;
  shown = versions.find((one) => one.version === Number(version)) ?? versions.at(-1);
  active = versions.find((one) => one.version === row.active_version) ?? null;
  knots = structuredClone(shown.content.knots);
  chosen = Math.min(chosen, knots.length - 1);
}
/** The newest cycle of the operation with samples, one at a varied feed before one at a constant feed, which teaches little of
 *  how the loads follow it: what is predicted is predicted on it. */
async function newestCycle(operation) {
  const fleet = await wholeFleet(5), varied = (item) => item.last_cycle.strategy && item.last_cycle.strategy !== "f_const";
  const of = fleet.filter((item) => item.last_cycle?.operation === operation).sort((a, b) => varied(b) - varied(a) || Date.parse(b.last_cycle.received_at) - Date.parse(a.last_cycle.received_at));
  for (const item of of.slice(0, 5)) { const cycle = await get(`/v1/machines/${segment(item.machine)}/cycles/${segment(item.last_cycle.cycle_id)}`); if (cycle.has_samples) return cycle; }
  return null;
}
/** How far the prediction can be trusted, beside it. */
function trust() {
  const answer = prediction?.answer;
  put($("#based"), !base ? t("profile.noBase") : html`${t("profile.basedOn", { cycle: base.cycle_id, machine: base.machine })}${answer ? html` ${t("profile.trust", { feed: num(answer.model_error.feed_drive_rms_points, 1), spindle: num(answer.model_error.spindle_rms_points, 1), unseen: num(answer.extrapolated_ratio * 100) })}` : ""}`);
  put($("#trust"), answer && answer.extrapolated_ratio > MOST_UNSEEN ? notice("plan", t("profile.farOff"), t("profile.farOffText", { unseen: num(answer.extrapolated_ratio * 100) })) : "");
}
async function begin() {
  if (!faults().length) rows();
  build();
  stepper();
  before = active && active.version !== shown.version ? await predict(active.content.knots).catch(() => null) : null;
  predictSoon();
}
async function none(lines) {
  const operations = await all("/v1/operations", 1000), tools = await all("/v1/tools", 1000), types = [...new Set(tools.items.map((one) => one.tool_type).filter(Boolean))], open = may(who, "POST /v1/feed-profiles/optimize");
  fill($("#main"), html`<div class="head"><div class="titles"><h1>${t("profile.all")}</h1></div></div><div id="said"></div><section class="panel body">${empty(t("profile.none"), t("profile.noneText"))}${operations.items.length ? html`<form class="set-form study-form" id="first"><div class="set-fields"><div class="field"><label for="o-name">${t("profile.name")}</label><input type="text" id="o-name" value="${operations.items[0].id}-profile"></div><div class="field"><label for="o-operation">${t("col.operation")}</label><select id="o-operation">${operations.items.map((one) => html`<option>${one.id}</option>`)}</select></div><div class="field"><label for="o-type">${t("profile.toolType")}</label><select id="o-type">${types.map((one) => html`<option>${one}</option>`)}</select></div></div><div class="knot-tools">${action(who, "POST /v1/feed-profiles/optimize", t("profile.optimise"), { type: "submit", primary: true })}</div></form>` : ""}</section>`);
  $("#first")?.addEventListener("submit", (event) => { event.preventDefault(); if (open) act($("[type=submit]", event.target), async () => { base = await newestCycle($("#o-operation").value); await optimise(); }); });
}
shell(t("nav.profile"));
fill($("#main"), html`<div class="panel body">${skeleton(6)}</div>`);
await opening(async () => {
  who = await session();
  const { items } = await all("/v1/feed-profiles", 1000), first = asked.get("id") ?? items.find((one) => one.operation === asked.get("operation"))?.id ?? items.find((one) => one.active_version != null)?.id ?? items[0]?.id;
  if (!first) await none(items);
  else {
    await Promise.all([load(first, asked.get("version")), ready(), may(who, "GET /v1/tokens") ? all("/v1/tokens", 5000).then(({ items: tokens }) => { names = new Map(tokens.map((one) => [one.id, one.name])); }) : null]);
    base = await newestCycle(row.operation);
    frame(items);
    guard(pending);
    addEventListener("session", ({ detail }) => { who = detail; paint(); stepper(); });
    await begin();
    keep(async () => {
      const now = await get(`/v1/feed-profiles/${segment(row.id)}`);
      if (now.revision === row.revision) return;
      // Somebody else took a step. What was moved here stays, and is saved as a draft of its own.
      const mine = pending() ? knots : null;
      await load(row.id, shown.version);
      if (mine) knots = mine;
      await begin();
      fill($("#said"), notice("", t("profile.movedOn")));
    }, BEAT_MS);
  }
}, (error) => fill($("#main"), html`<section class="panel body">${error.status === 404 ? empty(t("notfound.title"), t("notfound.text"), html`<a class="btn" href="/">${t("nav.fleet")}</a>`, true) : failure(error, t("error.load"))}</section>`));
