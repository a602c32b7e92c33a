// Numbers as they are typed. A field of numbers is one of text: a browser's own drops a comma without a word, so that 7,3 would
// be stored as 73. A text that is no number is not taken as an emptied field, which would erase what is stored: it is marked,
// and stays as it was typed.
import { $$, html } from "./html.js";
import { failure, notice } from "./states.js";
import { language, saidAt, t } from "./text.js";

const [POINT, GROUPS] = language === "de" ? [",", /^[+-]?[1-9]\d{0,2}\.\d{3}(e|$)/i] : [".", /^[+-]?[1-9]\d{0,2},\d{3}(e|$)/i];
/** A number as a field shows it, in the page's language. */
export const written = (value) => value == null ? "" : String(value).replace(".", POINT);
/** The number that a text says, with a decimal point or a decimal comma; null where it is empty, NaN where it says none, or
 *  maybe another one: what groups thousands in the page's language is no decimal sign. */
export function number(text) {
  const plain = text.trim().replace("\u2212", "-");
  if (plain === "") return null;
  const value = /^[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?$/i.test(plain) && !GROUPS.test(plain) ? Number(plain.replace(",", ".")) : NaN;
  // JSON has no infinity: it would be taken for nothing, and nothing for an emptied field.
  return Number.isFinite(value) ? value : NaN;
}
/** A field for a number. */
export const numeric = (id, value, more = "") => html`<input type="text" inputmode="decimal" autocomplete="off" spellcheck="false" ${id ? html`id="${id}"` : ""} value="${written(value)}" ${more}>`;

/** Marks a field, and says why in `said`. */
export function wrong(input, said, why) {
  input.setAttribute("aria-invalid", "true");
  if (said?.id) input.setAttribute("aria-describedby", said.id);
  if (said) said.textContent = why;
}
export function right(input, said) {
  input.removeAttribute("aria-invalid");
  input.removeAttribute("aria-describedby");
  if (said) said.textContent = "";
}
const place = (input) => document.getElementById(`${input.id}-said`);
const valueOf = (input) => number(input.value);
/** What is wrong with the text of a field for a number, null where nothing is. */
export const fault = (input, needed = input.required) => { const value = valueOf(input); return Number.isNaN(value) ? t("number.bad") : needed && value == null ? t("number.needed") : null; };

/** The numbers of these fields, an empty one as null; null instead of them all where one is wrong, which is marked then. */
export function entered(inputs, { needed, say = place } = {}) {
  for (const input of inputs) right(input, say(input));
  const bad = inputs.filter((input) => fault(input, needed));
  for (const input of bad) wrong(input, say(input), fault(input, needed));
  bad[0]?.focus();
  return bad.length ? null : inputs.map(valueOf);
}

/** What the server found at a field, in words: of a type it speaks as a program does. */
function found({ code, message, path }, input) {
  const line = /\[(\d+)\]/.exec(path)?.[1];
  if (line != null) return t("number.line", { line: Number(line) + 1, why: saidAt(message) });
  if (code !== "wrong_type" && code !== "missing_field") return saidAt(message);
  const value = valueOf(input);
  return value == null ? t("number.needed") : Number.isInteger(value) || Number.isNaN(value) ? t("number.bad") : t("number.whole");
}
/** Says at its field what the server refuses of it, and gives what there is to say of the whole; `of(path)` gives a field. */
export function refused(error, of, title) {
  const left = [];
  let first = null;
  for (const one of error.errors ?? []) {
    const input = of(one.path), said = input && place(input);
    if (!said) { left.push(one); continue; }
    wrong(input, said, [said.textContent, found(one, input)].filter(Boolean).join(" "));
    first ??= input;
  }
  first?.focus();
  if (!first) return failure(error, title);
  if (left.length === 0) return notice("act", title ?? t("error.title"), t("set.lookAtFields"));
  return failure({ ...error, code: "fields", message: `${left[0].path}: ${saidAt(left[0].message)}`, errors: left }, title);
}

const state = (form) => $$("input, select, textarea", form).map((one) => one.type === "checkbox" ? one.checked : one.value).join("\n");
/** Takes a form as it stands as not filled yet. */
export const untouched = (form) => { form.given = state(form); };
/** Whether something stands in a form that nobody has saved. */
export const touched = (form) => form.given !== undefined && form.given !== state(form);
