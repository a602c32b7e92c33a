import { $, element, fill, html, trusted } from "../html.js";
import { ApiError, post } from "../api.js";
import { icon } from "../icons.js";
import { told, language, setLanguage, t } from "../text.js";

document.title = `${t("sign.title")} \u2013 Feedwright`;
fill($("#main"), html`<section class="sign panel">
  <header class="sign-head"><span class="brand">${trusted($(".topbar .brand").innerHTML)}</span><button class="btn quiet" id="language" lang="${language === "de" ? "en" : "de"}" aria-label="${t("app.languageLabel")}">${t("app.language")}</button></header>
  <h1>${t("sign.title")}</h1><p class="muted">${t("sign.what")}</p>
  <form id="form" novalidate>
    <label for="token">${t("sign.token")}</label>
    <div class="sign-row"><input type="password" id="token" autocomplete="current-password" spellcheck="false" autocapitalize="off" aria-describedby="said"><button type="button" class="btn" id="show" aria-pressed="false">${t("sign.show")}</button></div>
    <div id="said" role="alert"></div>
    <label class="check"><input type="checkbox" id="lasting"><span>${t("sign.lasting")}</span></label>
    <p class="small muted">${t("sign.shift")}</p>
    <button class="btn primary sign-go" type="submit">${t("sign.in")}</button>
  </form>
  <p class="small muted">${t("sign.help")} <code>feedwright token create</code>.</p>
</section>`);
const token = $("#token");
token.focus();
$("#language").addEventListener("click", () => setLanguage(language === "de" ? "en" : "de"));
$("#show").addEventListener("click", (event) => {
  const shown = token.type === "password";
  token.type = shown ? "text" : "password";
  event.currentTarget.setAttribute("aria-pressed", String(shown));
  event.currentTarget.textContent = t(shown ? "sign.hide" : "sign.show");
});
const say = (text) => { $("#said").replaceChildren(element(html`<p class="flag act">${icon("act")}<span>${text}</span></p>`)); token.setAttribute("aria-invalid", "true"); token.focus(); };
/** Where to go on: an address of our own as the browser itself reads it, never another site. */
function next() {
  const asked = new URLSearchParams(location.search).get("next") || "/";
  let to;
  try { to = new URL(asked, location.href); } catch { return "/"; }
  // Given on whole: of a path that begins with // only the beginning says whose it is.
  return asked.startsWith("/") && to.origin === location.origin && !to.pathname.startsWith("/sign-in") ? to.href : "/";
}
$("#form").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (!token.value.trim()) { say(t("sign.empty")); return; }
  try {
    await post("/v1/session", { token: token.value.trim(), lasting: $("#lasting").checked });
    location.replace(next());
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    say(told("problem", error.code, error.message));
  }
});
