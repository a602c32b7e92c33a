import { $, $$, fill, html, put, trusted } from "../html.js";
import { shell } from "../shell.js";
import { empty, failure, notice, progress, skeleton } from "../states.js";
import { closedFor } from "../actions.js";
import { ApiError, all, computed, may, post, session } from "../api.js";
import { entered, number, numeric, refused, right, wrong } from "../fields.js";
import { opening } from "../live.js";
import { NB, num, unit } from "../format.js";
import { X, Y, chart, clip, dpr, halo, FONT, line, nice, phone, ready, splits, token } from "../charts.js";
import { Track } from "../track.js";
import { t, told } from "../text.js";

const TABS = ["strategies", "vibratory", "turning", "plunge"];
/** `visit` ends when another tab is shown: what is answered later is not written there. */
let who = null, plots = [], visit = new AbortController();
const value = (id) => number($(`#${id}`).value);
const field = (id, name, un, start) => html`<div class="field"><label for="${id}">${name}${un ? html` <span class="unit">${un}</span>` : ""}</label>${numeric(id, start)}<p class="said" id="${id}-said"></p></div>`;
/** What was entered under each tab, by the field: it is there again when the tab is. */
const typed = new Map();
const remember = () => { for (const one of $$("#ask input, #ask select, #ask textarea")) typed.set(one.id, one.type === "checkbox" ? one.checked : one.value); };
function form(what, fields, note = "") {
  fill($("#panel"), html`<p class="muted study-what">${what}</p><form class="set-form study-form" id="ask" novalidate><div class="set-fields">${fields}</div><div class="knot-tools"><button class="btn primary" type="submit">${t("study.compute")}</button></div></form><div id="said"></div><div id="answer">${note}</div>`);
  for (const one of $$("#ask input, #ask select, #ask textarea").filter(({ id }) => typed.has(id))) {
    const was = typed.get(one.id);
    if (one.type === "checkbox") one.checked = was; else if (one.tagName !== "SELECT" || [...one.options].some((option) => option.value === was)) one.value = was;
  }
}
let under = null;
addEventListener("pagehide", () => under?.abort());
/** What was computed before is no answer to what is entered now. */
function clear() {
  under?.abort();
  plots.forEach((plot) => plot.destroy());
  plots = [];
  fill($("#answer"), "");
}
/** Asks on every submit and once at the beginning, and then no longer for what was asked before; what was entered stays where
 *  it fails, and the field is named: `fields` has it by the path in the question. `check` looks at what is no number. */
async function asking(work, fields, check = () => true) {
  const of = (path) => { for (let at = path.replace(/\[\d+\]/g, ""); at; at = at.slice(0, Math.max(0, at.lastIndexOf(".")))) if (fields[at]) return document.getElementById(fields[at]); return null; };
  const run = async (event) => {
    event?.preventDefault();
    fill($("#said"), "");
    for (const input of $$("#ask [aria-invalid]")) right(input, document.getElementById(`${input.id}-said`));
    if (!entered($$("#ask input[inputmode]")) || !check()) { clear(); return; }
    under?.abort();
    const mine = under = new AbortController();
    const late = setTimeout(() => fill($("#answer"), skeleton(5)), 300);
    try { await work(mine.signal); } catch (error) { if (mine.signal.aborted) return; if (!(error instanceof ApiError)) throw error; clear(); fill($("#said"), refused(error, of)); } finally { clearTimeout(late); }
  };
  $("#ask").addEventListener("submit", run);
  await run();
}

// Strategies compared: the table and the radar of Stryczek & Błaszczak 2020, Fig. 21, on the process model.
const looks = [["--sig-override", ""], ["--sig-spindle", "7 3"], ["--sig-feed", "2 3"], ["--sig-feed-drive", "9 3 2 3"]];
function radar(rows) {
  const axes = ["duration", "energy", "thrust", "torque", "power"], size = 150, middle = [230, 178], at = (i, part) => { const angle = -Math.PI / 2 + i * 2 * Math.PI / axes.length; return [middle[0] + Math.cos(angle) * size * part, middle[1] + Math.sin(angle) * size * part]; };
  const path = (points) => trusted(`M${points.map((point) => point.map((v) => v.toFixed(1)).join(" ")).join("L")}Z`);
  return html`<svg class="radar" viewBox="0 0 460 370" role="img" aria-label="${t("study.radarAria")}">${[0.25, 0.5, 0.75, 1].map((part) => html`<path class="ring" d="${path(axes.map((_, i) => at(i, part)))}"/>`)}${axes.map((axis, i) => { const [x, y] = at(i, 1), [lx, ly] = at(i, 1.13); return html`<path class="ring" d="${trusted(`M${middle.join(" ")}L${x.toFixed(1)} ${y.toFixed(1)}`)}"/><text x="${trusted(lx.toFixed(1))}" y="${trusted((ly + 4).toFixed(1))}" text-anchor="${i === 0 ? "middle" : lx > middle[0] + 5 ? "start" : lx < middle[0] - 5 ? "end" : "middle"}">${t(`study.axis.${axis}`)}</text>`; })}
    ${rows.map((row, n) => html`<path fill="none" stroke="${trusted(`var(${looks[n % looks.length][0]})`)}" stroke-width="1.9" stroke-dasharray="${looks[n % looks.length][1]}" d="${path(axes.map((axis, i) => at(i, row.radar[axis])))}"/>`)}</svg>`;
}
async function strategies() {
  form(t("study.strategiesWhat"), html`${field("s-cycles", t("study.cycles"), "", 0)}${field("s-sheet", t("field.thickness_mm"), "mm", 2)}${field("s-feed", t("whatif.feed"), "%", 30)}${field("s-spindle", t("whatif.spindle"), "%", 40)}`);
  await asking(async (signal) => {
    const law = { set_feed_drive_percent: value("s-feed"), set_spindle_percent: value("s-spindle") };
    const answer = await post("/v1/friction/simulate", { model: { tool: { cycles: value("s-cycles") }, operation: { sheet: { thickness_mm: value("s-sheet") } } }, limits: { feed_drive_percent: value("s-feed"), spindle_percent: value("s-spindle") }, compare: [{ base: "f_const" }, { base: "f_sec" }, { base: "f_lin" }, { base: "f_ac", law }] }, { signal });
    const rows = answer.comparison, words = { F_Const: "f_const", F_Sec: "f_sec", F_Lin: "f_lin", F_AC: "f_ac" };
    const columns = [["duration_s", "s", 2, (one) => one.duration_s], ["energy_j", "J", 0, (one) => one.energy_j], ["thrust_n", "N", 0, (one) => one.thrust_n.value], ["torque_nm", "N\u00b7m", 2, (one) => one.torque_nm.value], ["power_w", "W", 0, (one) => one.power_w.value], ["feed_drive_percent", "%", 1, (one) => one.feed_drive_percent.value], ["spindle_percent", "%", 1, (one) => one.spindle_percent.value], ["overload_s", "s", 2, (one) => one.overload_s]];
    const best = columns.map(([, , , of]) => Math.min(...rows.map(of)));
    const adaptive = rows.at(-1), linear = rows[2];
    fill($("#answer"), html`<p class="verdict sub">${t("study.strategiesSay", { fastest: told("strategy", words[rows.reduce((a, b) => a.duration_s < b.duration_s ? a : b).name] ?? ""), power: num(Math.abs(adaptive.power_w.value / linear.power_w.value - 1) * 100, 0) + NB + "%", less: adaptive.power_w.value < linear.power_w.value })}</p><div class="study-grid"><figure>${radar(rows)}<figcaption class="key">${rows.map((row, n) => html`<span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="${trusted(`var(${looks[n][0]})`)}" stroke-width="2" stroke-dasharray="${looks[n][1]}"/></svg>${told("strategy", words[row.name] ?? row.name, row.name)}</span>`)}</figcaption></figure>
      <div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><caption class="sr">${t("study.strategies")}</caption><thead><tr><th scope="col">${t("study.strategy")}</th>${columns.map(([name, un]) => html`<th scope="col" class="num">${t(`study.${name}`)}, ${un}</th>`)}</tr></thead><tbody>${rows.map((row) => html`<tr><th scope="row">${told("strategy", words[row.name] ?? row.name, row.name)}</th>${columns.map(([, , digits, of], i) => html`<td class="num">${of(row) === best[i] ? html`<b>${num(of(row), digits)}</b>` : num(of(row), digits)}</td>`)}</tr>`)}</tbody></table><p class="small muted pad">${t("study.strategiesNote")}</p></div></div>`);
  }, { "model.tool.cycles": "s-cycles", "model.operation.sheet": "s-sheet", "limits.feed_drive_percent": "s-feed", "limits.spindle_percent": "s-spindle", "compare.law.set_feed_drive_percent": "s-feed", "compare.law.set_spindle_percent": "s-spindle" });
}

// Vibratory drilling: continuity and amplitude over frequency ratio and cutting coefficient, with the stability border.
async function vibratory() {
  form(t("study.vibratoryWhat"), html`${field("v-p0", t("study.pFrom"), "", 1)}${field("v-p1", t("study.pTo"), "", 2)}${field("v-k0", t("study.kFrom"), "", 0.02)}${field("v-k1", t("study.kTo"), "", 0.6)}${field("v-n", t("study.points"), "", 31)}<div class="field"><label for="v-what">${t("study.show")}</label><select id="v-what"><option value="continuity">${t("study.continuity")}</option><option value="amplitude">${t("study.amplitude")}</option><option value="peak_force">${t("study.peakForce")}</option></select></div><div class="field"><label class="check"><input type="checkbox" id="v-control"><span>${t("study.control")}</span></label></div>`);
  await asking(async (signal) => {
    const count = Math.min(101, Math.max(2, value("v-n"))), axis = (from, to) => ({ min: value(from), max: value(to), count });
    const body = { frequency_ratio: axis("v-p0", "v-p1"), cutting_coefficient: axis("v-k0", "v-k1"), control: $("#v-control").checked ? { adaptation: 0.002, target: 0.9, actuator_limit: 0.1 } : null };
    const ratios = Array.from({ length: 201 }, (_, i) => body.frequency_ratio.min + i / 200 * (body.frequency_ratio.max - body.frequency_ratio.min));
    const [map, border] = await Promise.all([computed("/v1/vibratory/map", body, { signal, progress: (job) => fill($("#answer"), html`<p class="muted">${t("study.computing", { done: num(job.done), total: num(job.total) })}</p>${progress(job.total ? job.done / job.total : 0)}`) }), post("/v1/vibratory/border", { frequency_ratios: ratios }, { signal })]);
    await ready();
    signal.throwIfAborted();
    draw(map, border, body);
  }, { frequency_ratio: "v-p0", "frequency_ratio.max": "v-p1", "frequency_ratio.count": "v-n", frequency_ratios: "v-p0", cutting_coefficient: "v-k0", "cutting_coefficient.max": "v-k1", "cutting_coefficient.count": "v-n", control: "v-control" });
  function draw(map, border, body) {
    const name = $("#v-what").value, values = map[name], columns = map.frequency_ratios.length, rows = map.cutting_coefficients.length;
    // Where nothing is cut, or the motion grows without end, there is no steady value to show.
    const steady = (i) => map.cuts[i] && Number.isFinite(values[i]), told = values.filter((_, i) => steady(i)), without = told.length < values.length;
    const finite = told.sort((a, b) => a - b), low = name === "continuity" ? 0 : finite[0], high = name === "continuity" ? 1 : finite[Math.floor(finite.length * 0.98)];
    const unstable = border.points.length ? map.frequency_ratios.reduce((sum, p) => sum + map.cutting_coefficients.filter((k) => k > borderAt(border, body, p)).length, 0) / (columns * rows) : 0;
    fill($("#answer"), html`<p class="verdict sub">${t("study.vibratorySay", { share: num(unstable * 100), least: num(border.minimum, 3) })}</p><div class="key"><span>${t(`study.${name === "peak_force" ? "peakForce" : name}`)}</span><span><svg viewBox="0 0 20 8" aria-hidden="true"><rect width="20" height="8" fill="var(--map-low)"/></svg>${num(low, 2)}</span><span><svg viewBox="0 0 20 8" aria-hidden="true"><rect width="20" height="8" fill="var(--map-high)"/></svg>${num(high, 2)}</span><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-limit)" stroke-width="2" stroke-dasharray="5 3"/></svg>${t("study.border")}</span>${without ? html`<span><svg viewBox="0 0 20 8" aria-hidden="true"><rect width="20" height="8" fill="var(--control)"/></svg>${t("study.noCut")}</span>` : ""}<span class="hint" id="at" role="status"></span></div><div id="map" class="u-wrap" tabindex="0" role="group" aria-label="${t("study.mapKeys")}"></div><p class="xname">${t("study.xRatio")}</p>`);
    const half = [(body.frequency_ratio.max - body.frequency_ratio.min) / (columns - 1) / 2, (body.cutting_coefficient.max - body.cutting_coefficient.min) / (rows - 1) / 2];
    let here = [Math.floor(columns / 2), Math.floor(rows / 2)], moved = false;
    const shade = (part) => `color-mix(in srgb, ${token("--map-high")} ${Math.round(Math.max(0, Math.min(1, part)) * 100)}%, ${token("--map-low")})`;
    const say = () => { const i = here[1] * columns + here[0]; put($("#at"), t("study.mapAt", { p: num(map.frequency_ratios[here[0]], 3), k: num(map.cutting_coefficients[here[1]], 3), value: steady(i) ? num(values[i], 3) : t("study.noCut"), bursting: map.bursting[i] ? t("study.bursting") : "" })); };
    const plot = chart($("#map"), { height: phone() ? 320 : 460, pad: [8, phone() ? 8 : 24, 0, 0], axisX: true, zoom: false, left: 52, xr: [body.frequency_ratio.min - half[0], body.frequency_ratio.max + half[0]], range: () => [body.cutting_coefficient.min - half[1], body.cutting_coefficient.max + half[1]], aria: t("study.mapAria"),
      back: (u, c) => { for (let row = 0; row < rows; row++) for (let column = 0; column < columns; column++) { const p = map.frequency_ratios[column], k = map.cutting_coefficients[row], x = X(u, p - half[0]), y = Y(u, k + half[1]); const i = row * columns + column; c.fillStyle = steady(i) ? shade((values[i] - low) / Math.max(1e-12, high - low)) : token("--control"); c.fillRect(Math.floor(x), Math.floor(y), Math.ceil(X(u, p + half[0])) - Math.floor(x), Math.ceil(Y(u, k - half[1])) - Math.floor(y)); } },
      front: (u, c) => {
        const k = dpr(); c.save(); clip(u);
        c.lineJoin = "round"; c.beginPath(); border.points.forEach((point, i) => { const x = X(u, body.frequency_ratio.min + i / (border.points.length - 1) * (body.frequency_ratio.max - body.frequency_ratio.min)), y = Y(u, Math.min(point.cutting_coefficient, body.cutting_coefficient.max * 3)); if (i) c.lineTo(x, y); else c.moveTo(x, y); });
        c.strokeStyle = token("--surface"); c.lineWidth = 4.5 * k; c.stroke(); c.strokeStyle = token("--sig-limit"); c.lineWidth = 2 * k; c.setLineDash([6 * k, 4 * k]); c.stroke(); c.setLineDash([]);
        c.font = `600 ${12 * k}px ${FONT}`; c.fillStyle = token("--ink"); c.textAlign = "center"; c.textBaseline = "top"; halo(c, t("study.unstable"), u.bbox.left + u.bbox.width / 2, u.bbox.top + 10 * k);
        if (moved) { const x = X(u, map.frequency_ratios[here[0]]), y = Y(u, map.cutting_coefficients[here[1]]); c.strokeStyle = token("--ink"); c.lineWidth = 2 * k; c.strokeRect(x - 5 * k, y - 5 * k, 10 * k, 10 * k); }
        c.restore();
      },
      onCursor: (u) => { if (!u.cursor.event || u.cursor.left < 0) return; const nearest = (list, at) => Math.max(0, Math.min(list.length - 1, Math.round((at - list[0]) / (list.at(-1) - list[0]) * (list.length - 1)))); here = [nearest(map.frequency_ratios, u.posToVal(u.cursor.left, "x")), nearest(map.cutting_coefficients, u.posToVal(u.cursor.top, "y"))]; say(); } });
    plots.push(plot);
    $("#map").addEventListener("keydown", (event) => { const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key]; if (!step) return; event.preventDefault(); moved = true; here = [Math.max(0, Math.min(columns - 1, here[0] + step[0])), Math.max(0, Math.min(rows - 1, here[1] + step[1]))]; say(); plot.redraw(false); });
    say();
  }
  // A declaration: the first map is drawn before the lines below the question are reached.
  function borderAt(border, body, p) { return border.points[Math.round((p - body.frequency_ratio.min) / (body.frequency_ratio.max - body.frequency_ratio.min) * (border.points.length - 1))]?.cutting_coefficient ?? Infinity; }
}

// Turning: the plan over the tool's life beside fixed parameters (Alaskari & Oraby 2017).
async function turning() {
  const { items } = await all("/v1/models/turning", 1000, { signal: visit.signal });
  if (items.length === 0) { library("turning"); return; }
  form(t("study.turningWhat"), html`<div class="field"><label for="t-model">${t("study.model")}</label><select id="t-model">${items.map((one) => html`<option value="${one.id}">${one.id}</option>`)}</select></div>${field("t-depth", t("field.depth_mm"), "mm", 2.5)}${field("t-power", t("study.power"), "kW", 7)}${field("t-force", t("study.force"), "N", 1500)}${field("t-wear", t("study.wear"), "mm", 0.3)}${field("t-speed0", t("study.speedFrom"), "m/min", 50)}${field("t-speed1", t("study.speedTo"), "m/min", 200)}${field("t-feed0", t("study.feedFrom"), "mm/rev", 0.06)}${field("t-feed1", t("study.feedTo"), "mm/rev", 0.6)}${field("t-change", t("study.toolChange"), "min", 1)}`);
  await asking(async (signal) => {
    const answer = await post("/v1/turning/plan", { job: { model: { id: $("#t-model").value }, depth_mm: value("t-depth"), limits: { power_kw: value("t-power"), force_n: value("t-force"), wear_mm: value("t-wear") }, domain: { grid: { speed_m_min: { min: value("t-speed0"), max: value("t-speed1"), step: 10 }, feed_mm_rev: { min: value("t-feed0"), max: value("t-feed1"), step: 0.005 } } }, economics: { tool_change_min: value("t-change"), machine_cost_per_min: 1 } } }, { signal });
    await ready();
    signal.throwIfAborted();
    const plan = answer.plan, fixed = answer.fixed, gain = answer.comparison?.removed;
    const figure = (name, one, other, un, digits) => html`<div><dt>${name}</dt><dd>${num(one, digits)} <span class="unit">${un}</span></dd><dd class="vs">${other == null ? trusted("&nbsp;") : t("study.fixedIs", { value: num(other, digits) })}</dd></div>`;
    fill($("#answer"), html`<p class="verdict sub">${gain == null ? t("study.turningNoFixed") : t("study.turningSay", { gain: num(gain, 1), minutes: unit(plan.totals.cutting_min, "min", 1) })}</p><dl class="figures">${figure(t("study.cuttingTime"), plan.totals.cutting_min, fixed?.totals.cutting_min, "min", 1)}${figure(t("study.removed"), plan.totals.removed_mm3 / 1000, fixed == null ? null : fixed.totals.removed_mm3 / 1000, "cm\u00b3", 0)}${figure(t("study.meanRemoval"), plan.totals.mean_removal_mm3_min / 1000, fixed == null ? null : fixed.totals.mean_removal_mm3_min / 1000, "cm\u00b3/min", 1)}${figure(t("study.overallRemoval"), plan.totals.overall_removal_mm3_min == null ? null : plan.totals.overall_removal_mm3_min / 1000, fixed?.totals.overall_removal_mm3_min == null ? null : fixed.totals.overall_removal_mm3_min / 1000, "cm\u00b3/min", 1)}${figure(t("study.endWear"), plan.totals.wear_mm, fixed?.totals.wear_mm, "mm", 3)}</dl>
      <div class="key"><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--ink)" stroke-width="2" stroke-dasharray="5 3"/></svg>${t("study.plan")}</span><span><svg viewBox="0 0 20 8" aria-hidden="true"><path d="M0 4h20" stroke="var(--sig-reference)" stroke-width="1.6" stroke-dasharray="5 3"/></svg>${t("study.fixed")}</span></div><div id="plan"></div><p class="xname">${t("study.xCutting")}</p>
      <details><summary>${t("study.asTable")}</summary><div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col" class="num">${t("study.from")}, min</th><th scope="col" class="num">${t("study.speed")}, m/min</th><th scope="col" class="num">${t("study.feed")}, mm/rev</th><th scope="col" class="num">${t("study.wear")}, mm</th><th scope="col" class="num">${t("study.power")}, kW</th><th scope="col" class="num">${t("study.force")}, N</th><th scope="col">${t("study.binding")}</th></tr></thead><tbody>${plan.intervals.map((one) => html`<tr><td class="num">${num(one.start_min, 1)}</td><td class="num">${num(one.speed_m_min)}</td><td class="num">${num(one.feed_mm_rev, 3)}</td><td class="num">${num(one.wear_mm, 3)}</td><td class="num">${num(one.power_kw, 2)}</td><td class="num">${num(one.force_n)}</td><td>${told("binding", one.binding, one.binding)}</td></tr>`)}</tbody></table></div></details>${answer.warnings.map((one) => notice("", one.message ?? one.code))}`);
    const steps = (run, name) => { const x = [], y = []; for (const one of run.intervals) { x.push(one.start_min, one.end_min - 1e-6); y.push(one[name], one[name]); } return new Track(x, { value: y }); };
    const slope = (run, name) => { const x = [0], y = [0]; for (const one of run.intervals) { x.push(one.end_min); y.push(one[name]); } return new Track(x, { value: y }); };
    const end = Math.max(plan.totals.cutting_min, fixed?.totals.cutting_min ?? 0), rows = [["speed_m_min", t("study.speed"), "m/min", steps, "--sig-override"], ["feed_mm_rev", t("study.feed"), "mm/rev", steps, "--sig-feed"], ["wear_mm", t("study.wear"), "mm", slope, "--sig-energy"]];
    rows.forEach(([name, title, un, of, color], i) => {
      const mine = of(plan, name), other = fixed ? of(fixed, name) : null, top = Math.max(...mine.columns.value, ...(other ? other.columns.value : [0])), high = nice(top * 1.08);
      const row = document.createElement("div"); row.className = "row"; fill(row, html`<div class="chart-title"><b>${title}</b><span>${un}</span></div><div class="u-wrap"></div>`); $("#plan").append(row);
      plots.push(chart($(".u-wrap", row), { height: 110 + (i === 2 ? 30 : 0), pad: [8, phone() ? 10 : 40, 0, 0], axisX: i === 2, zoom: false, left: 52, xr: [0, end * 1.02], range: () => [0, high], ysplits: () => splits(0, high).filter((_, n) => n % 2 === 0), aria: `${title}, ${un}`, front: (u) => { if (other) line(u, other, "value", { color: "--sig-reference", width: 1.25, dash: [5, 3] }); line(u, mine, "value", { color, dash: [6, 3] }); } }));
    });
  }, { "job.model": "t-model", "job.depth_mm": "t-depth", "job.limits.power_kw": "t-power", "job.limits.force_n": "t-force", "job.limits.wear_mm": "t-wear", "job.domain.grid.speed_m_min": "t-speed0", "job.domain.grid.speed_m_min.max": "t-speed1", "job.domain.grid.feed_mm_rev": "t-feed0", "job.domain.grid.feed_mm_rev.max": "t-feed1", "job.economics.tool_change_min": "t-change" });
}

// Plunge feeds of a drill table (Lengerov).
const DRILLS = [[3, 60, 2000], [5, 85, 1500], [8, 117, 1000], [12, 150, 800]];
async function plunge() {
  const { items } = await all("/v1/models/plunge", 1000, { signal: visit.signal });
  if (items.length === 0) { library("plunge"); return; }
  form(t("study.plungeWhat"), html`<div class="field"><label for="p-model">${t("study.material")}</label><select id="p-model">${items.map((one) => html`<option value="${one.id}">${one.id}${one.name ? `, ${one.name}` : ""}</option>`)}</select></div>${field("p-least", t("field.limits.feed_min_mm_min"), "mm/min", 1)}${field("p-most", t("field.limits.feed_max_mm_min"), "mm/min", 5000)}${field("p-bite", t("study.bite"), "mm", 0.5)}${field("p-detect", t("study.detector"), "", 4)}${field("p-period", t("study.period"), "s", 0.01)}${field("p-answer", t("study.answer"), "s", 0.02)}<div class="field wide-field"><label for="p-drills">${t("study.drills")}</label><textarea id="p-drills" rows="5" spellcheck="false">${DRILLS.map((one) => one.join("; ")).join("\n")}</textarea><p class="said" id="p-drills-said"></p></div>`);
  let drills = [];
  const lines = () => {
    drills = $("#p-drills").value.split("\n").map((text) => text.trim()).filter(Boolean).map((text) => text.split(";").map(number));
    const bad = drills.findIndex((one) => one.length !== 3 || one.some((part) => part == null || Number.isNaN(part)));
    if (bad < 0) return true;
    wrong($("#p-drills"), $("#p-drills-said"), t("study.badDrill", { line: bad + 1 }));
    $("#p-drills").focus();
    return false;
  };
  await asking(async (signal) => {
    const mine = drills;
    const answer = await post("/v1/plunge/feed", { material: { id: $("#p-model").value }, machine: { least_feed_mm_min: value("p-least"), greatest_feed_mm_min: value("p-most") }, latency: { allowed_bite_mm: value("p-bite"), detector_samples: value("p-detect"), sample_period_s: value("p-period"), answer_age_s: value("p-answer") }, drills: mine.map(([diameter_mm, length_mm, spindle_rpm]) => ({ diameter_mm, length_mm, spindle_rpm })) }, { signal });
    const most = Math.max(1, ...answer.drills.map((one) => one.feed_mm_min ?? 0));
    fill($("#answer"), html`<div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><caption class="sr">${t("study.plunge")}</caption><thead><tr><th scope="col" class="num">${t("study.diameter")}, mm</th><th scope="col" class="num">${t("study.length")}, mm</th><th scope="col" class="num">${t("field.spindle_speed_rpm")}, ${t("unit.rpm")}</th><th scope="col" class="num">${t("study.plungeFeed")}, mm/min</th><th scope="col"><span class="sr">${t("study.bar")}</span></th><th scope="col">${t("study.binding")}</th><th scope="col" class="num">${t("study.biteIs")}, mm</th><th scope="col" class="num">${t("study.criticalThrust")}, N</th></tr></thead><tbody>${answer.drills.map((one, i) => html`<tr><th scope="row" class="num">${num(mine[i][0], 1)}</th><td class="num">${num(mine[i][1])}</td><td class="num">${num(mine[i][2])}</td><td class="num"><b>${one.feed_mm_min == null ? t("none") : num(one.feed_mm_min)}</b></td><td><svg class="bar" viewBox="0 0 160 10" width="160" height="10" aria-hidden="true"><rect width="160" height="10" fill="var(--sunken)"/><rect width="${trusted(((one.feed_mm_min ?? 0) / most * 160).toFixed(1))}" height="10" fill="var(--sig-feed)"/></svg></td><td>${told("bound", one.limit)}</td><td class="num">${one.bite_mm == null ? "" : num(one.bite_mm, 3)}</td><td class="num">${num(one.critical_thrust_n)}</td></tr>`)}</tbody></table></div>${answer.warnings.map((one) => notice("", one.message ?? one.code))}`);
  }, { material: "p-model", "machine.least_feed_mm_min": "p-least", "machine.greatest_feed_mm_min": "p-most", "latency.allowed_bite_mm": "p-bite", "latency.detector_samples": "p-detect", "latency.sample_period_s": "p-period", "latency.answer_age_s": "p-answer", drills: "p-drills" }, lines);
}
function library(kind) {
  const route = `PUT /v1/models/${kind}/{model}`;
  fill($("#panel"), empty(t("study.noModel"), `${t("study.noModelText", { path: `/v1/models/${kind}` })} ${may(who, route) ? "" : closedFor(who.role, route)}`, html`<a class="btn" href="/docs/">${t("set.api")}</a>`));
}

const shows = { strategies, vibratory, turning, plunge };
async function show() {
  remember();
  under?.abort();
  visit.abort();
  const mine = visit = new AbortController();
  plots.forEach((plot) => plot.destroy());
  plots = [];
  const wanted = location.hash.slice(1), tab = TABS.includes(wanted) ? wanted : TABS[0];
  for (const link of $$("#tabs a")) if (link.hash === `#${tab}`) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  fill($("#panel"), skeleton(5));
  try { await shows[tab](); } catch (error) { if (mine.signal.aborted) return; if (!(error instanceof ApiError)) throw error; fill($("#panel"), failure(error, t("error.load"))); }
}
shell(t("nav.studies"));
fill($("#main"), html`<div class="head"><div class="titles"><h1>${t("nav.studies")}</h1><p class="evidence">${t("study.what")}</p></div></div><nav class="tabs" id="tabs" aria-label="${t("nav.studies")}">${TABS.map((name) => html`<a href="#${name}">${t(`study.${name}`)}</a>`)}</nav><section class="panel body" id="panel">${skeleton(5)}</section>`);
addEventListener("hashchange", show);
await opening(async () => { who = await session(); await show(); }, (error) => fill($("#panel"), failure(error, t("error.load"))));
