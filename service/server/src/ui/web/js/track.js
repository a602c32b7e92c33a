// A recorded signal over depth or time, drawn at any zoom: minimum and maximum per pixel column, never every n-th sample.
// A pyramid of block minima and maxima makes a frame cost what the screen shows, not what was recorded.

const FACTOR = 8;

/** Minima and maxima of blocks of FACTOR, FACTOR², … values. NaN is no value. */
export function pyramid(values) {
  const levels = [];
  let low = values, high = values;
  while (low.length > FACTOR * 4) {
    const count = Math.ceil(low.length / FACTOR), lows = new Float64Array(count), highs = new Float64Array(count);
    for (let i = 0; i < count; i++) {
      let min = Infinity, max = -Infinity;
      for (let k = i * FACTOR, end = Math.min(low.length, k + FACTOR); k < end; k++) { if (low[k] < min) min = low[k]; if (high[k] > max) max = high[k]; }
      lows[i] = min; highs[i] = max;
    }
    levels.push({ lows, highs });
    low = lows; high = highs;
  }
  return levels;
}

/** First place with x[i] >= value; x ascends. */
export function placeOf(x, value) {
  let from = 0, to = x.length;
  while (from < to) { const mid = (from + to) >> 1; if (x[mid] < value) from = mid + 1; else to = mid; }
  return from;
}

/** Columns over one ascending x. */
export class Track {
  constructor(x, columns) {
    this.x = Float64Array.from(x);
    this.columns = {};
    this.levels = {};
    for (const [name, values] of Object.entries(columns)) if (values) this.columns[name] = Float64Array.from(values, (v) => v ?? NaN);
  }
  has(name) { return Boolean(this.columns[name]); }
  /** How many samples lie between two values of x. */
  between(min, max) { return placeOf(this.x, max) - placeOf(this.x, min); }
  /** Minimum and maximum of places from..to (exclusive); null where there is no value. */
  extremes(name, from, to) {
    const values = this.columns[name];
    let min = Infinity, max = -Infinity;
    if (to - from <= 8 * FACTOR) {
      for (let i = from; i < to; i++) { const value = values[i]; if (value < min) min = value; if (value > max) max = value; }
      return min > max ? null : [min, max];
    }
    const levels = this.levels[name] ??= pyramid(values);
    const take = (lows, highs, a, b) => { for (let i = a; i < b; i++) { if (lows[i] < min) min = lows[i]; if (highs[i] > max) max = highs[i]; } };
    let level = -1, a = from, b = to, lows = values, highs = values;
    // Up the pyramid from both ends: only what no larger block covers is looked at on each level.
    while (level + 1 < levels.length && b - a > 2 * FACTOR) {
      const up = Math.ceil(a / FACTOR), down = Math.floor(b / FACTOR);
      if (up >= down) break;
      take(lows, highs, a, up * FACTOR);
      take(lows, highs, down * FACTOR, b);
      level += 1;
      ({ lows, highs } = levels[level]);
      a = up; b = down;
    }
    take(lows, highs, a, b);
    return min > max ? null : [min, max];
  }
  /** The value at x, between its neighbours; null outside. */
  at(name, value) {
    const { x } = this, values = this.columns[name];
    if (!values || x.length === 0 || value < x[0] || value > x[x.length - 1]) return null;
    const i = Math.min(x.length - 1, placeOf(x, value));
    if (i === 0 || x[i] === value) return Number.isNaN(values[i]) ? null : values[i];
    const part = (value - x[i - 1]) / (x[i] - x[i - 1]), between = values[i - 1] + part * (values[i] - values[i - 1]);
    return Number.isNaN(between) ? null : between;
  }
  /** Calls draw(x, min, max) for what a plot of `width` pixels shows of min..max: every sample, or every pixel column. */
  each(name, min, max, width, draw) {
    const { x } = this, values = this.columns[name];
    const from = Math.max(0, placeOf(x, min) - 1), to = Math.min(x.length, placeOf(x, max) + 2);
    if (to - from <= 2 * width) { for (let i = from; i < to; i++) draw(x[i], values[i], values[i]); return; }
    const step = (max - min) / width;
    let i = from;
    while (i < to) {
      const edge = (Math.floor((x[i] - min) / step) + 1) * step + min;
      let end = i + 1;
      // Samples are all but evenly spaced: a guess, then the exact place.
      if (end < to && x[end] < edge) { end = placeFrom(x, edge, i + 1, to); }
      const found = this.extremes(name, i, end);
      if (found) draw(x[i], found[0], found[1], values[i], values[end - 1]); else draw(x[i], NaN, NaN);
      i = end;
    }
  }
}
function placeFrom(x, value, from, to) {
  let step = 1, low = from;
  while (low + step < to && x[low + step] < value) { low += step; step *= 2; }
  let high = Math.min(to, low + step + 1);
  while (low < high) { const mid = (low + high) >> 1; if (x[mid] < value) low = mid + 1; else high = mid; }
  return Math.max(low, from);
}

/** The way forward over depth: samples that are deeper than every one before, from `first` mm on. */
export function forward(depth, first) {
  const places = [];
  let deepest = -Infinity;
  for (let i = 0; i < depth.length; i++) if (depth[i] >= first && depth[i] > deepest) { deepest = depth[i]; places.push(i); }
  return places;
}
