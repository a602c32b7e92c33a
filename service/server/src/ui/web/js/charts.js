// One way to draw every chart: uPlot for axes, cursor and zoom with the tokens of the page; lines by our own hand, so that
// a line never costs more than the pixels it covers; names in the right margin, no legend box.
import uPlot from "../vendor/uplot/uPlot.esm.js";
import { num } from "./format.js";

let cache = {};
export const token = (name) => cache[name] ||= getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const all = new Set();
addEventListener("retheme", () => { cache = {}; for (const chart of all) chart.redraw(false, true); });
export const FONT = '"Plex Sans", sans-serif';
/** Canvas text needs the font to be there; a slow one is not waited for. */
export const ready = () => Promise.race([Promise.all([document.fonts.load(`12px ${FONT}`), document.fonts.load(`600 12px ${FONT}`)]), new Promise((wake) => setTimeout(wake, 1500))]);
export const dpr = () => devicePixelRatio || 1;
export const phone = () => innerWidth <= 720;

const axis = (options) => ({ stroke: () => token("--ink-3"), font: `12px ${FONT}`, gap: 6, grid: { stroke: () => token("--grid"), width: 1 }, ticks: { show: false }, ...options });
const plain = (u, values) => values.map((value) => num(value, Math.max(0, ...values.map(digits))));
const digits = (value) => { const text = String(+value.toPrecision(6)); const at = text.indexOf("."); return at < 0 ? 0 : Math.min(4, text.length - at - 1); };

/** A plot of `options.height` in `host`; `back` and `front` draw, `range()` gives y, `xr` the whole of x. */
export function chart(host, options) {
  const pad = options.pad ?? [8, phone() ? 12 : 84, 0, 0];
  const plot = new uPlot({
    width: Math.max(60, host.clientWidth), height: options.height, padding: [pad[0], pad[1], options.axisX ? null : 6, pad[3]], ms: 1,
    cursor: { y: false, points: { show: false }, drag: { x: options.zoom !== false, y: false, setScale: true, uni: 10 }, ...(options.cursor ?? {}) },
    select: { show: options.zoom !== false }, legend: { show: false },
    scales: { x: { time: false, range: (u, low, high) => u.zoomed ? [low, high] : options.xr }, y: { range: () => options.range() } },
    axes: [
      axis({ show: Boolean(options.axisX), size: options.axisX ? 30 : 0, values: options.xvals ?? plain, space: 64, grid: { show: options.gridX === true, stroke: () => token("--grid"), width: 1 } }),
      axis({ size: options.left ?? 44, splits: options.ysplits ? () => options.ysplits() : undefined, values: options.yvals ?? plain, space: 26 }),
    ],
    series: [{}, { points: { show: false }, paths: () => null }],
    hooks: {
      drawClear: [(u) => { u.ctx.save(); clip(u); options.back?.(u, u.ctx); u.ctx.restore(); }],
      draw: [(u) => { u.ctx.save(); options.front?.(u, u.ctx); u.ctx.restore(); }],
      ready: options.onReady ? [(u) => options.onReady(u)] : [],
      setCursor: options.onCursor ? [(u) => options.onCursor(u)] : [],
      setScale: options.onScale ? [(u, key) => key === "x" && options.onScale(u)] : [],
    },
  }, [options.xr, [null, null]], host);
  all.add(plot);
  for (const canvas of host.querySelectorAll("canvas")) { canvas.setAttribute("role", "img"); canvas.setAttribute("aria-label", options.aria ?? ""); }
  let width = host.clientWidth;
  const watch = new ResizeObserver(() => { if (host.clientWidth !== width && host.clientWidth > 0) { width = host.clientWidth; plot.setSize({ width, height: options.height }); options.onSize?.(plot); } });
  watch.observe(host);
  const destroy = plot.destroy.bind(plot);
  plot.destroy = () => { watch.disconnect(); all.delete(plot); destroy(); };
  return plot;
}

export const clip = (u) => { u.ctx.beginPath(); u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); u.ctx.clip(); };
export const X = (u, value) => u.valToPos(value, "x", true), Y = (u, value) => u.valToPos(value, "y", true);

/** A recorded line in what the plot shows of it. */
export function line(u, track, name, { color, width = 1.9, dash = [], alpha = 1 } = {}) {
  if (!track?.has(name)) return;
  const c = u.ctx, k = dpr(), { min, max } = u.scales.x;
  if (min == null) return;
  c.save();
  clip(u);
  c.strokeStyle = token(color); c.lineWidth = width * k; c.globalAlpha = alpha; c.setLineDash(dash.map((part) => part * k));
  c.fillStyle = c.strokeStyle;
  c.beginPath();
  const { min: low, max: high } = u.scales.y, { left, top, width: w, height: h } = u.bbox;
  const sx = w / (max - min), sy = h / (high - low), y = (value) => top + (high - value) * sy;
  const lonely = [];
  // Where every pixel column has its stroke, a bar in each looks the same, and corners are most of what a stroke costs.
  if (dash.length === 0 && track.between(min, max) > 2 * w) bars(c, track, name, { min, max, w, at: (x) => left + (x - min) * sx, y, thick: width * k });
  else {
    c.lineJoin = "round";
    let pen = false, alone = null, px = 0, flat = null, drawn = null;
    track.each(name, min, max, Math.round(w), (x, a, b) => {
      if (Number.isNaN(a)) { if (flat !== null && pen) c.lineTo(px, y(flat)); if (alone) lonely.push(alone); alone = null; flat = null; pen = false; return; }
      const at = left + (x - min) * sx;
      // A stretch of one value is one piece of the line, however many samples it has.
      if (pen && a === b && a === drawn) { px = at; flat = a; alone = null; return; }
      if (flat !== null && pen) c.lineTo(px, y(flat));
      flat = null;
      if (pen) { c.lineTo(at, y(a)); alone = null; } else { c.moveTo(at, y(a)); pen = true; alone = b === a ? [at, y(a)] : null; }
      if (b !== a) c.lineTo(at, y(b));
      drawn = b; px = at;
    });
    if (flat !== null && pen) c.lineTo(px, y(flat));
    c.stroke();
    if (alone) lonely.push(alone);
  }
  // A value without neighbours makes no line: it is a dot.
  for (const [px, py] of lonely) { c.beginPath(); c.arc(px, py, Math.max(2, width * 1.2) * k, 0, 7); c.fill(); }
  c.restore();
}

/** A dense line: in every pixel column a bar from its least to its greatest value, and on to the column before. */
function bars(c, track, name, { min, max, w, at, y, thick }) {
  // Bars on each other would be seen through a line that is not opaque: there each is as wide as its column.
  const wide = c.globalAlpha < 1 ? 1 : Math.max(1, Math.round(thick)), tall = Math.max(1, thick);
  const begin = Math.floor(at(min)) - 1, end = Math.ceil(at(max)) + 1;
  let before = null, from = 0, to = 0, up = NaN, down = NaN;
  const put = () => { if (up <= down) c.fillRect(from - (wide >> 1), up - tall / 2, to - from + wide, down - up + tall); };
  const bar = (px, a, b) => {
    const high = y(before ? Math.max(b, before[1]) : b), low = y(before ? Math.min(a, before[2]) : a);
    if (high === up && low === down && px === to + 1) to = px; else { put(); from = to = px; up = high; down = low; }
    before = [px, a, b];
  };
  track.each(name, min, max, Math.round(w), (_, a, b, edge) => {
    if (Number.isNaN(a)) { put(); up = NaN; before = null; return; }
    const px = Math.round(at(edge));
    // Samples that lie further apart than a column are joined, as any line joins its samples.
    if (before && px > before[0] + 1) for (let [last, low, high] = before, i = Math.max(begin, last + 1); i < Math.min(end, px); i++) { const part = (i - last) / (px - last); bar(i, low + part * (a - low), high + part * (b - high)); }
    bar(px, a, b);
  });
  put();
}

/** A horizontal limit with its name in the right margin (or inside, on a phone). */
export function limit(u, c, value, text, { color = "--sig-limit", dash = [5, 4], width = 1.25, bold = false, below = false, side, shift = 0 } = {}) {
  const k = dpr(), y = Math.round(Y(u, value)) + 0.5, { left, width: w, top, height } = u.bbox;
  if (y < top - 1 || y > top + height + 1) return;
  c.strokeStyle = token(color); c.lineWidth = width * k; c.setLineDash(dash.map((part) => part * k));
  c.beginPath(); c.moveTo(left, y); c.lineTo(left + w, y); c.stroke(); c.setLineDash([]);
  if (text) label(u, c, y + shift * k, text, color, { bold, below, side });
}
export function label(u, c, y, text, color, { bold = false, below = false, side = "right" } = {}) {
  const k = dpr(), { left, width: w } = u.bbox;
  c.font = `${bold ? 600 : 400} ${12 * k}px ${FONT}`; c.fillStyle = token(color); c.textBaseline = "middle";
  if (text.startsWith("L_set ")) { // L with a real subscript
    const rest = text.slice(5), weight = bold ? 600 : 400, font = (px) => { c.font = `${weight} ${px * k}px ${FONT}`; };
    const inside = phone(), draw = inside ? (part, x, at) => halo(c, part, x, at) : (part, x, at) => c.fillText(part, x, at);
    c.textAlign = "left";
    font(12); const wl = c.measureText("L").width, wr = c.measureText(rest).width; font(9.5); const ws = c.measureText("set").width;
    let x = inside ? left + w - 3 * k - wl - ws - wr : left + w + 8 * k;
    const at = inside ? y + (below ? 9 : -9) * k : y;
    font(12); draw("L", x, at); x += wl; font(9.5); draw("set", x, at + 3.5 * k); x += ws; font(12); draw(rest, x, at);
    return;
  }
  if (phone()) { const atLeft = side === "left"; c.textAlign = atLeft ? "left" : "right"; c.textBaseline = below ? "top" : "bottom"; halo(c, text, atLeft ? left + 5 * k : left + w - 3 * k, y + (below ? 3 : -3) * k); }
  else { c.textAlign = "left"; c.fillText(text, left + w + 8 * k, y); }
}
export function halo(c, text, x, y) {
  c.save(); c.lineJoin = "round"; c.lineWidth = 4 * dpr(); c.strokeStyle = token("--surface"); c.strokeText(text, x, y); c.restore(); c.fillText(text, x, y);
}
export function vline(u, c, value, { color = "--ink-3", dash = [], width = 1 } = {}) {
  const k = dpr(), x = Math.round(X(u, value)) + 0.5;
  c.strokeStyle = token(color); c.lineWidth = width * k; c.setLineDash(dash.map((part) => part * k));
  c.beginPath(); c.moveTo(x, u.bbox.top); c.lineTo(x, u.bbox.top + u.bbox.height); c.stroke(); c.setLineDash([]);
}
export function hatch(u, c, color, gap = 9) {
  const { left: x, top: y, width: w, height: h } = u.bbox, step = gap * dpr();
  c.strokeStyle = token(color); c.lineWidth = dpr(); c.beginPath();
  for (let at = -h; at < w + h; at += step) { c.moveTo(x + at, y + h); c.lineTo(x + at + h, y); }
  c.stroke();
}
/** A round number at or above the value, so that a scale stays where it is from one cycle to the next. */
export const nice = (value) => { if (!(value > 0)) return 1; const base = 10 ** Math.floor(Math.log10(value)), part = value / base; return ([1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].find((step) => part <= step + 1e-9)) * base; };
/** 3 to 5 labelled values from low to high. */
export const splits = (low, high) => { const span = high - low, raw = span / 4, base = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 2.5, 5, 10].map((part) => part * base).find((size) => span / size <= 4.5), found = []; for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-9; value += step) found.push(+value.toPrecision(12)); return found; };
