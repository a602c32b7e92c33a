// Numbers, units, times as the reader's language writes them: thin space groups, a true minus, the unit after a narrow
// no-break space, times in the reader's zone and with its name: a picture of a page does not tell it.
import { language, t } from "./text.js";

export const NB = "\u202f";
const locale = language === "de" ? "de-DE" : "en-GB";
const formats = new Map();
const format = (digits) => {
  if (!formats.has(digits)) formats.set(digits, new Intl.NumberFormat(locale, { minimumFractionDigits: digits, maximumFractionDigits: digits }));
  return formats.get(digits);
};
const group = language === "de" ? /\./g : /,/g;

export const num = (value, digits = 0) => value == null || !Number.isFinite(value) ? t("none") : format(digits).format(value).replace(group, NB).replace("-", "\u2212").replace(/^\u2212(0([.,]0+)?)$/, "$1");
export const signed = (value, digits = 0) => { const text = num(value, digits); return Number.isFinite(value) && +value.toFixed(digits) > 0 ? `+${text}` : text; };
export const unit = (value, name, digits = 0) => `${num(value, digits)}${NB}${name}`;
export const percent = (value, digits = 0) => unit(value, "%", digits);
/** A count that lies ahead: two digits are all that is known. */
export const rounded = (value) => { if (value < 20) return num(Math.round(value)); const step = 10 ** (Math.floor(Math.log10(value)) - 1); return num(Math.round(value / step) * step); };

const clock = new Intl.DateTimeFormat(locale, { hour: "2-digit", minute: "2-digit", hourCycle: "h23", timeZoneName: "short" });
const clockSeconds = new Intl.DateTimeFormat(locale, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23", timeZoneName: "short" });
const day = new Intl.DateTimeFormat(locale, { day: "numeric", month: "short", year: "numeric" });
const shortDay = new Intl.DateTimeFormat(locale, { day: "numeric", month: "short" });
export const time = (at) => clock.format(new Date(at));
export const timeSeconds = (at) => clockSeconds.format(new Date(at));
export const date = (at) => day.format(new Date(at));
export const dayMonth = (at) => shortDay.format(new Date(at));
export const moment = (at) => `${date(at)}, ${timeSeconds(at)}`;
/** "4 s", "47 min", "3 h 12 min", "2 d". */
export const span = (ms) => {
  const s = Math.max(0, Math.round(ms / 1000));
  if (s < 60) return unit(s, "s");
  // What is rounded is taken apart: 59 min 45 s are an hour, not 60 min.
  const minutes = Math.round(s / 60), h = Math.floor(minutes / 60), m = minutes % 60;
  if (h === 0) return unit(m, "min");
  if (h < 24) return m ? `${unit(h, "h")} ${unit(m, "min")}` : unit(h, "h");
  return unit(Math.floor(h / 24), language === "de" ? "Tg." : "d");
};
/** An age up to a day, a date after. */
export const age = (ms, at) => ms < 86400000 ? t("ago", { span: span(ms) }) : date(at);
