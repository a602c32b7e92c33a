// What was entered and is not saved does not vanish without a question.
import { $ } from "./html.js";
import { confirm } from "./dialog.js";
import { t } from "./text.js";

let pending = () => false;
/** Asks from now on before the page is left while `unsaved()`. */
export function guard(unsaved) { pending = unsaved; }
/** Whether something stands here that signing in as another person, or leaving, would lose. */
export const unsaved = () => pending() || Boolean($("dialog[open]:not(#again)"));
/** Leaves the page where nobody is asked any more: what was entered is saved, or given up. */
export function leave(address) { pending = () => false; location.assign(address); }
/** Whether what was entered may go: nothing was, or somebody said so. */
export const mayLeave = async () => !pending() || confirm({ title: t("leave.title"), text: t("leave.text"), label: t("leave.go"), cancel: t("leave.stay") });
addEventListener("beforeunload", (event) => { if (pending()) event.preventDefault(); });
