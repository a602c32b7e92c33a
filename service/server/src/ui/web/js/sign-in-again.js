// The session ended while a page was open: asked for a token in a dialog, over what was being done.
import { $, element, fill, html } from "./html.js";
import { icon } from "./icons.js";
import { ApiError, get, lasting, post } from "./api.js";
import { told, t } from "./text.js";

/** Ready when somebody is signed in again. Another person than before finds the page made anew: it may do other things. */
export function signInAgain() {
  return new Promise((done) => {
    const dialog = element(html`<dialog id="again" aria-labelledby="again-h" aria-describedby="again-what"><form method="dialog" novalidate><h2 id="again-h">${t("again.title")}</h2><p class="muted" id="again-what">${t("again.text")}</p><label for="again-token">${t("sign.token")}</label><input type="password" id="again-token" autocomplete="current-password" spellcheck="false" autocapitalize="off"><div id="again-said" role="alert"></div><label class="check"><input type="checkbox" id="again-lasting" ${lasting ? html`checked` : ""}><span>${t("sign.lasting")}</span></label><div class="knot-tools"><button class="btn primary" type="submit">${t("sign.in")}</button></div></form></dialog>`);
    document.body.append(dialog);
    const before = document.querySelector("#who")?.textContent;
    // Without a session nothing behind it answers: it is not closed by Escape.
    dialog.addEventListener("cancel", (event) => event.preventDefault());
    dialog.showModal();
    $("#again-token", dialog).focus();
    $("form", dialog).addEventListener("submit", async (event) => {
      event.preventDefault();
      try {
        await post("/v1/session", { token: $("#again-token", dialog).value.trim(), lasting: $("#again-lasting", dialog).checked });
        const who = await get("/v1/session");
        dialog.close();
        dialog.remove();
        if (before && before !== `${who.name}, ${t(`role.${who.role}`)}`) location.reload();
        done();
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        fill($("#again-said", dialog), html`<p class="flag act">${icon("act")}<span>${told("problem", error.code, error.message)}</span></p>`);
        $("#again-token", dialog).focus();
      }
    });
  });
}
