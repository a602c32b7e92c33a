// What a verdict on a tool looks like, on every page alike: one scale, one bar, one way to say it.
import { html, trusted } from "./html.js";
import { icon } from "./icons.js";
import { NB, percent, rounded, signed } from "./format.js";
import { t } from "./text.js";

/** The level that decides, as percent over the new tool; null before there is one, and where nothing decides because the
 *  feed hides the wear: the energy as run says nothing good then. */
export const levelPercent = (wear) => wear?.level?.decides ? (wear.level.value - 1) * 100 : null;
/** Whether there is energy to compare, but the feed hides what it says of wear. */
export const isHidden = (wear) => Boolean(wear?.level && !wear.level.decides);
/** Percent as it is shown, and as it is judged: the state rules, not the rounding. */
export const shownLevel = (value) => `${signed(value, 1)}${NB}%`;
/** The baseline that is being learnt, of what the tool ran last; null where that has one. */
export const learnt = (wear) => wear?.baselines?.[0] && wear.baselines[0].baseline_joules == null ? wear.baselines[0] : null;
export const wearClass = (wear) => wear?.state === "worn" ? "act" : wear?.state === "warning" ? "plan" : "";

const WIDEST = 12;
const fixed = (value) => trusted(String(Math.round(value * 10) / 10));
/** Bullet graph, 0 to +12 %, a dashed tick at the warning, a full one at worn. */
export function wearBar(wear, { width = 118, height = 10 } = {}) {
  const value = levelPercent(wear);
  if (value == null) return "";
  const x = (v) => Math.max(0, Math.min(v, WIDEST)) / WIDEST * width;
  const warn = (wear.level.warning_at - 1) * 100, worn = (wear.level.worn_at - 1) * 100;
  return html`<svg width="${width}" height="${height + 6}" viewBox="0 0 ${width} ${height + 6}" preserveAspectRatio="none" role="img" aria-label="${t("wear.aria", { value: shownLevel(value) })}">
    <rect class="track" x="0" y="3" width="${width}" height="${height}" rx="1"/><rect class="fill" x="0" y="3" width="${fixed(x(value))}" height="${height}" rx="1"/>
    <path class="tick" d="M${fixed(x(warn))} 3v${height}" stroke-dasharray="2 2"/><path class="tick worn" d="M${fixed(x(worn))} 0v${height + 6}"/></svg>`;
}
export function wearCell(wear) {
  const value = levelPercent(wear);
  if (value == null) {
    if (isHidden(wear)) return html`<span class="wear"><span class="val faint" title="${t("wear.hiddenWhy")}">${t("wear.hidden")}</span></span>`;
    return html`<span class="wear"><span class="val faint">${wear?.state === "learning" || learnt(wear) ? t("wear.noBaseline") : t("wear.notKnown")}</span></span>`;
  }
  return html`<span class="wear ${wearClass(wear)}">${wearBar(wear)}<span class="val">${shownLevel(value)}</span></span>`;
}
/** Energies over the new tool's on the fleet's one scale, −2 to +12 %. */
export function sparkline(ratios, { width = 112, height = 24 } = {}) {
  if (ratios.length < 2) return "";
  const y = (v) => height - 2 - (Math.max(-2, Math.min(WIDEST, v)) + 2) / 14 * (height - 4), x = (i) => 2 + i / (ratios.length - 1) * (width - 8);
  const points = ratios.map((ratio, i) => `${fixed(x(i))} ${fixed(y((ratio - 1) * 100))}`);
  return html`<svg class="spark" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" role="img" aria-label="${t("spark.aria")}"><path class="base" d="M0 ${fixed(y(0))}h${width}"/><path class="worn" d="M0 ${fixed(y(10))}h${width}"/>
    <path d="M${trusted(points.join("L"))}"/><circle cx="${fixed(x(ratios.length - 1))}" cy="${fixed(y((ratios.at(-1) - 1) * 100))}" r="2"/></svg>`;
}
/** Cycles that are left, with nothing said where nothing is known. */
export function cyclesLeft(wear, silent) {
  if (!wear) return { count: null, text: t("left.unknown") };
  if (wear.state === "worn") return { count: 0, text: null };
  if (silent) return { count: null, text: t("left.stale") };
  if (!wear.level) return { count: null, text: t("left.unknown") };
  if (!wear.remaining) return { count: null, text: t("left.early") };
  return { count: wear.remaining.cycles, text: null };
}
export const leftCell = (left) => left.count == null ? html`<span class="faint">${left.text}</span>` : html`${rounded(left.count)}<span class="card-word"> ${t("left.word")}</span>`;

const worst = { worn: 0, broken_suspected: 1, overload: 2, machine_silent: 3, conditions_changed: 4, quarantine: 5 };
const levels = { worn: "act", broken_suspected: "act", overload: "act", conditions_changed: "plan", machine_silent: "plan", quarantine: "plan" };
/** What to do about a machine whose newest cycle ran a tool, which `wear` is of: `{ level, text, more }`, null where nothing is. */
export function todo(alarms, wear, { silentFor, tool } = {}) {
  const open = [...alarms].sort((a, b) => (worst[a.kind] ?? 9) - (worst[b.kind] ?? 9) || a.id - b.id);
  const [first] = open, value = levelPercent(wear);
  const found = (level, text, more = 0) => ({ level, text, more });
  // A machine may have a magazine of tools: what is known of another one is its name.
  const isOfAnother = first?.tool != null && first.tool !== tool;
  const says = (alarm) => isOfAnother ? `${t(`alarm.${alarm.kind}`)} (${alarm.tool})` : alarm.kind === "worn" && value != null ? t("todo.wornEnergy", { level: shownLevel(value) }) : t(`alarm.${alarm.kind}`);
  if (first && levels[first.kind] !== "plan") return found("act", says(first), open.length - 1);
  if (silentFor) return found("plan", t("todo.silent", { span: silentFor }), open.length);
  // A tool with a few cycles left does not wait for what was not accepted.
  const isNearEnd = wear?.state === "warning" && first?.kind !== "conditions_changed";
  if (first && !isNearEnd) return found("plan", says(first), open.length - 1);
  if (isNearEnd) return found("plan", wear.remaining ? t("todo.warning", { cycles: rounded(wear.remaining.cycles) }) : t("todo.warningUnknown"), open.length);
  const learning = wear?.state === "learning" && learnt(wear);
  if (learning) return found("note", t("todo.learning", { have: learning.learnt_from, need: learning.needed }));
  return null;
}
export const flag = (found) => found ? html`<span class="flag ${found.level}">${icon(found.level)}<span>${found.text}${found.more > 0 ? html` <span class="faint">${t("todo.more", { count: found.more })}</span>` : ""}</span></span>` : "";
