// When there is nothing, not yet, or not any more to show.
import { icon } from "./icons.js";
import { html, trusted } from "./html.js";
import { saidAt, told, t } from "./text.js";

export const notice = (level, title, text, more = "") => html`<div class="notice ${level}" role="${level === "act" ? "alert" : "status"}">${icon(level === "offline" ? "silent" : level || "note")}<div><b>${title}</b>${text ? html`<p>${text}</p>` : ""}${more}</div></div>`;
/** What an error says: what happened, where, and that nothing is lost. */
export function failure(error, title = t("error.title")) {
  const offline = error.code === "offline";
  const fields = (error.errors ?? []).slice(0, 8);
  const [only] = fields;
  const words = told("problem", error.code, fields.length === 1 && only.path ? `${only.path}: ${saidAt(only.message)}` : error.message);
  return notice(offline ? "plan" : "act", title, fields.length > 1 ? null : words, html`
    ${fields.length > 1 ? html`<ul class="field-errors">${fields.map((field) => html`<li><code>${field.path}</code> ${saidAt(field.message)}</li>`)}</ul>` : ""}
    <p class="faint">${t("error.kept")}${error.requestId ? html` ${t("error.request")} <code>${error.requestId}</code>` : ""}</p>`);
}
/** `whole` where there is nothing else on the page: its title is the page's then. */
export const empty = (title, text, actions = "", whole = false) => html`<div class="empty">${whole ? html`<h1>${title}</h1>` : html`<h2>${title}</h2>`}<p>${text}</p><div class="knot-tools">${actions}</div></div>`;
export const progress = (part) => html`<svg class="prog" viewBox="0 0 100 3" preserveAspectRatio="none" aria-hidden="true"><rect width="100" height="3" fill="var(--sunken)"/><rect width="${trusted(String(Math.max(0, Math.min(100, part * 100))))}" height="3" fill="var(--ink-2)"/></svg>`;
export const skeleton = (rows = 3) => html`<div class="skeleton" role="status" aria-busy="true" aria-label="${t("loading")}">${Array.from({ length: rows }, () => html`<i></i>`)}</div>`;
