// Numbers as they are typed. A number field whose text is no number has an empty value: read as one that was emptied, it
// would erase what is stored, so it is told apart, marked, and stays as it was typed.
import { t } from "./text.js";

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
/** What is wrong with the text of a number field, null where nothing is. */
export const fault = (input, needed = false) => input.validity.badInput ? t("number.bad") : needed && input.value === "" ? t("number.needed") : null;

/** The numbers of these fields, an empty one as null; null instead of them all where one is wrong, which is marked then. */
export function entered(inputs, { needed = false, say = (input) => document.getElementById(`${input.id}-said`) } = {}) {
  for (const input of inputs) right(input, say(input));
  const bad = inputs.filter((input) => fault(input, needed));
  for (const input of bad) wrong(input, say(input), fault(input, needed));
  bad[0]?.focus();
  return bad.length ? null : inputs.map((input) => input.value === "" ? null : Number(input.value));
}
