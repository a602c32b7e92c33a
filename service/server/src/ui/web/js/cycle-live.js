// The machine of a cycle as it works: the cycle under way, drawn while it is drilled, and the newer one when it is stored.
import { $, element, html, put } from "./html.js";
import { icon } from "./icons.js";
import { keep, listen } from "./live.js";
import { chart, limit, line, nice, phone, splits } from "./charts.js";
import { Track } from "./track.js";
import { get, segment } from "./api.js";
import { time, unit } from "./format.js";
import { t } from "./text.js";

/** Samples that are drawn of a cycle under way; of a longer one every other is forgotten, again and again. */
export const MOST_SAMPLES = 4000;
/** Without a connection the newest cycle is asked for this often, ms. */
const BEAT_MS = 15_000;
const ROWS = [["spindle_load_percent", "cycle.spindle", "--sig-spindle"], ["feed_drive_load_percent", "cycle.feedDrive", "--sig-feed-drive"], ["override_percent", "cycle.override", "--sig-override"]];

/** A cycle under way, bounded. */
export class Growing {
  constructor(id) { this.id = id; this.time = []; this.columns = Object.fromEntries([...ROWS.map(([name]) => name), "depth_mm"].map((name) => [name, []])); this.stride = 1; this.seen = 0; this.last = null; this.missed = false; }
  /** Nothing was heard for a while: what lies between is not known, and the line breaks. */
  miss() { this.missed = this.time.length > 0; }
  add(sample) {
    this.last = sample;
    this.seen += 1;
    if (this.seen % this.stride) return;
    if (this.time.length && sample.time_ms / 1000 <= this.time.at(-1)) return;
    if (this.missed) {
      this.missed = false;
      this.time.push((this.time.at(-1) + sample.time_ms / 1000) / 2);
      for (const column of Object.values(this.columns)) column.push(NaN);
    }
    this.time.push(sample.time_ms / 1000);
    for (const [name, column] of Object.entries(this.columns)) column.push(Number.isFinite(sample[name]) ? sample[name] : NaN);
    if (this.time.length < MOST_SAMPLES) return;
    const half = (column) => column.filter((_, i) => i % 2 === 0);
    this.time = half(this.time);
    for (const name of Object.keys(this.columns)) this.columns[name] = half(this.columns[name]);
    this.stride *= 2;
  }
}

/** `shown` is the cycle on the page, `known` the newest one when it was opened. */
export function cycleLive(machine, shown, known, host) {
  let growing = null, newer = null, plots = [], due = false, heard = false;
  const paint = () => {
    due = false;
    const running = heard && growing && !growing.ended;
    put(host, html`${newer ? html`<div class="notice" role="status">${icon("note")}<div><b>${t("cycle.newer", { time: time(newer.received_at) })}</b><p><a href="/cycle?machine=${segment(machine)}&amp;id=${segment(newer.cycle_id)}">${t("cycle.showNewer")}</a></p></div></div>` : ""}${running ? html`<section class="panel charts-panel" aria-label="${t("cycle.liveCurves")}"><p class="state running">${icon("drilling")}<b>${t("cycle.runs")}</b> <span id="live-values" class="muted"></span></p><div id="live-charts"></div><p class="xname">${t("cycle.xBegan")}</p></section>` : ""}`) && (plots.forEach((plot) => plot.destroy()), plots = []);
    if (!running) return;
    const at = growing.last;
    put($("#live-values", host), at ? t("cycle.runsText", { depth: at.depth_mm == null ? t("unknown") : unit(at.depth_mm, "mm", 1), load: at.spindle_load_percent == null ? t("unknown") : unit(at.spindle_load_percent, "%", 0) }) : t("cycle.runsBegun"));
    if (growing.time.length < 2) return;
    const track = new Track(growing.time, growing.columns), end = nice(growing.time.at(-1));
    if (plots.length === 0) plots = ROWS.map(([name, title, color], i) => {
      const row = element(html`<div class="row"><div class="chart-title"><b>${t(title)}</b><span>%</span></div><div class="u-wrap"></div></div>`);
      $("#live-charts", host).append(row);
      const high = () => nice(Math.max(20, ...growing.columns[name].filter(Number.isFinite)) * 1.05);
      const options = { height: 84 + (i === ROWS.length - 1 ? 30 : 0), pad: [6, phone() ? 10 : 96, 0, 0], axisX: i === ROWS.length - 1, zoom: false, left: 48, xr: [0, end], range: () => [0, high()], ysplits: () => splits(0, high()).filter((_, n) => n % 2 === 0), aria: t(title), front: (u, c) => { line(u, options.track, name, { color }); if (name === "override_percent") limit(u, c, 100, "", { color: "--ink-3", dash: [2, 3], width: 1 }); }, track };
      const plot = chart($(".u-wrap", row), options);
      plot.options = options;
      return plot;
    });
    for (const plot of plots) { plot.options.track = track; plot.options.xr[1] = end; plot.setScale("x", { min: 0, max: end }); plot.redraw(false, false); }
  };
  const soon = () => { if (!due) { due = true; requestAnimationFrame(paint); } };
  const begun = (event) => { if (event.state === "running" && event.cycle_id && growing?.id !== event.cycle_id) growing = new Growing(event.cycle_id); if (growing && event.state !== "running") growing.ended = event.state === "connected" || event.state === "disconnected"; soon(); };
  const live = listen(`machine=${segment(machine)}&samples=true`, {
    state: (event) => {
      heard = true;
      if (growing && !event.machines.some((one) => one.state === "running" && one.cycle_id === growing.id)) growing.ended = true;
      growing?.miss();
      for (const one of event.machines) begun(one);
      soon();
    },
    machine: begun,
    sample: (event) => { if (growing?.id !== event.cycle_id) growing = new Growing(event.cycle_id); growing.add(event); soon(); },
    cycle: (event) => { if (event.cycle_id !== shown) newer = event; if (growing?.id === event.cycle_id) growing.ended = true; soon(); },
  }, () => { heard = false; soon(); });
  // What came in while nobody looked, or while other pages of this browser listen.
  keep(async () => {
    if (live.heard()) return;
    const { last_cycle: last } = await get(`/v1/fleet/${segment(machine)}?recent=1`);
    if (!last || last.cycle_id === known) return;
    known = last.cycle_id;
    if (known !== shown) { newer = last; soon(); }
  }, BEAT_MS, { drawn: true });
}
