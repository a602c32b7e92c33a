// The session ended while a page was open: asked for a token in a dialog, over what was being done.
import { $, element, fill, html } from "./html.js";
import { icon } from "./icons.js";
import { busy } from "./actions.js";
import { ApiError, get, lasting, post, session } from "./api.js";
import { unsaved } from "./leave.js";
import { told, t } from "./text.js";

/** Who signed in here last. */
let latest = null;
const called = (who) => `${who.name}, ${t(`role.${who.role}`)}`;
/** Somebody whose token was made anew is still the same person. */
const same = (a, b) => a.token === b.token || (a.name === b.name && a.role === b.role);

/** Ready when the same person is signed in again: what was asked is repeated then. What somebody asked is not repeated in
 *  another one's name: it fails, and where nothing was entered the page is made anew, as another one may do other things. */
export async function signInAgain() {
  const before = latest ?? await session();
  const dialog = element(html`<dialog id="again" aria-labelledby="again-h" aria-describedby="again-what"><form method="dialog" novalidate><h2 id="again-h">${t("again.title")}</h2><p class="muted" id="again-what">${t("again.text")}</p><label for="again-token">${t("sign.token")}</label><input type="password" id="again-token" autocomplete="current-password" spellcheck="false" autocapitalize="off"><div id="again-said" role="alert"></div><label class="check"><input type="checkbox" id="again-lasting" ${lasting ? html`checked` : ""}><span>${t("sign.lasting")}</span></label><div class="knot-tools"><button class="btn primary" type="submit">${t("sign.in")}</button></div></form></dialog>`);
  document.body.append(dialog);
  // Without a session nothing behind it answers: it is not closed by Escape.
  for (const name of ["cancel", "keydown"]) dialog.addEventListener(name, (event) => { if (name === "cancel" || event.key === "Escape") event.preventDefault(); });
  dialog.showModal();
  $("#again-token", dialog).focus();
  const who = await new Promise((done) => $("form", dialog).addEventListener("submit", (event) => {
    event.preventDefault();
    busy($("[type=submit]", dialog), async () => {
      try {
        await post("/v1/session", { token: $("#again-token", dialog).value.trim(), lasting: $("#again-lasting", dialog).checked });
        done(await get("/v1/session"));
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        fill($("#again-said", dialog), html`<p class="flag act">${icon("act")}<span>${told("problem", error.code, error.message)}</span></p>`);
        $("#again-token", dialog).focus();
      }
    });
  }));
  latest = who;
  if (!same(before, who)) await otherPerson(dialog, before, who);
  dialog.close();
  dialog.remove();
  if (same(before, who)) return;
  if (!unsaved()) { location.reload(); await new Promise(() => {}); }
  dispatchEvent(new CustomEvent("session", { detail: who }));
  throw new ApiError(401, { code: "other_person", detail: t("again.other") });
}
/** Says that nothing goes on in the name of who is there now, and waits until it is read. */
function otherPerson(dialog, before, who) {
  fill(dialog, html`<form method="dialog"><h2 id="again-h">${t("again.otherTitle", { who: called(who) })}</h2><p id="again-what">${t("again.otherText", { before: called(before) })}</p><div class="knot-tools"><button class="btn primary" type="submit" id="again-on">${t("again.on")}</button></div></form>`);
  $("#again-on", dialog).focus();
  return new Promise((read) => $("form", dialog).addEventListener("submit", (event) => { event.preventDefault(); read(); }));
}
