// Asks before something that cannot be taken back, or that would lose what was entered.
import { $, element, fill, html } from "./html.js";
import { ApiError } from "./api.js";
import { busy } from "./actions.js";
import { failure } from "./states.js";
import { MOST_REASON, oneLine, t } from "./text.js";

/** Ready with whether it was done. `work` is given the reason where one is asked for (`reason` is what it is called); while it
 *  is under way nothing is pressed twice, and what it is refused is told in the dialog. */
export function confirm({ title, text, label, work, reason, cancel = t("cancel"), failed }) {
  const dialog = element(html`<dialog aria-labelledby="c-h"><form method="dialog" novalidate><h2 id="c-h">${title}</h2>${typeof text === "string" ? html`<p class="muted">${text}</p>` : text}${reason ? html`<label for="c-reason">${reason}</label><textarea id="c-reason" rows="3" maxlength="${MOST_REASON}" required></textarea>` : ""}<div id="c-said" role="alert"></div><div class="knot-tools apart"><button class="btn primary" type="submit">${label}</button><button class="btn" type="button" id="c-cancel" ${reason ? "" : html`autofocus`}>${cancel}</button></div></form></dialog>`);
  const go = $("[type=submit]", dialog);
  let done = false;
  document.body.append(dialog);
  dialog.showModal();
  $("#c-cancel", dialog).addEventListener("click", () => dialog.close());
  // What is under way is not called back by leaving; a browser lets a dialog go at the third Escape unless the key itself is held.
  for (const name of ["cancel", "keydown"]) dialog.addEventListener(name, (event) => { if (go.disabled && (name === "cancel" || event.key === "Escape")) event.preventDefault(); });
  $("form", dialog).addEventListener("submit", (event) => {
    event.preventDefault();
    const why = reason ? oneLine($("#c-reason", dialog).value) : undefined;
    if (why === "") { fill($("#c-said", dialog), html`<p class="said">${t("reason.needed")}</p>`); $("#c-reason", dialog).focus(); return; }
    busy(go, async () => {
      $("#c-cancel", dialog).disabled = true;
      try {
        fill($("#c-said", dialog), "");
        await work?.(why);
        done = true;
        dialog.close();
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        fill($("#c-said", dialog), failure(error, failed));
      } finally { $("#c-cancel", dialog).disabled = false; }
    });
  });
  return new Promise((answer) => dialog.addEventListener("close", () => { dialog.remove(); answer(done); }));
}
