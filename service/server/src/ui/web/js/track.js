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
  /** Calls draw(x, min, max) for what a plot of `width` pixels shows of min..max: every sample, or every pixel column, with
   *  where that begins.
   *  Columns stand still while the plot is panned: nothing flickers, and what was looked at once is not looked at again. */
  each(name, min, max, width, draw) {
    const { x } = this, values = this.columns[name];
    const from = Math.max(0, placeOf(x, min) - 1), to = Math.min(x.length, placeOf(x, max) + 2);
    if (to - from <= 2 * width) { for (let i = from; i < to; i++) draw(x[i], values[i], values[i]); return; }
    const { step, first, starts, seen } = this.pixels((max - min) / width), { low, high, known } = seen[name] ??= { low: new Float64Array(starts.length), high: new Float64Array(starts.length), known: new Uint8Array(starts.length) };
    const start = (column) => { if (starts[column] < 0) starts[column] = placeOf(x, (first + column) * step); return starts[column]; };
    const last = Math.min(starts.length - 2, Math.floor(x[to - 1] / step) - first);
    for (let column = Math.max(0, Math.floor(x[from] / step) - first); column <= last; column++) {
      const begin = start(column), end = start(column + 1);
      if (begin === end) continue;
      if (!known[column]) {
        const found = this.extremes(name, begin, end);
        low[column] = found ? found[0] : NaN; high[column] = found ? found[1] : NaN; known[column] = 1;
      }
      draw(x[begin], low[column], high[column], (first + column) * step);
    }
  }
  /** The pixel columns of the whole track for one zoom: where each begins, and what was found in it. */
  pixels(width) {
    const step = +width.toPrecision(9);
    if (this.grid?.step !== step) {
      const { x } = this, first = Math.floor(x[0] / step), count = Math.floor(x[x.length - 1] / step) - first + 1;
      this.grid = { step, first, starts: new Int32Array(count + 1).fill(-1), seen: {} };
      // Whatever rounding says of the outermost samples: none is left out.
      this.grid.starts[0] = 0;
      this.grid.starts[count] = x.length;
    }
    return this.grid;
  }
}

/** The way forward over depth: samples that are deeper than every one before, from `first` mm on. */
export function forward(depth, first) {
  const places = [];
  let deepest = -Infinity;
  for (let i = 0; i < depth.length; i++) if (depth[i] >= first && depth[i] > deepest) { deepest = depth[i]; places.push(i); }
  return places;
}
