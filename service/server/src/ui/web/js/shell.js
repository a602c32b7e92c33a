// The frame around every page: navigation on top (charts need the width), whether it is live, who is signed in.
import { icon } from "./icons.js";
import { $, element, html, put } from "./html.js";
import { ApiError, ask, may, session } from "./api.js";
import { failure } from "./states.js";
import { closedFor } from "./actions.js";
import { language, setLanguage, t } from "./text.js";

const pages = [
  ["fleet", "/", "fleet"], ["cycle", "/cycle", "cycle"], ["tool", "/tool", "tool"], ["profile", "/profile", "profile"],
  ["next", "/next", "advice"], ["studies", "/studies", "studies", "wide"], ["settings", "/settings", "more", "wide"],
];
const name = () => document.body.dataset.page;

export function redraw() { dispatchEvent(new Event("retheme")); }
function switchTheme() {
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
  try { localStorage.setItem("theme", root.dataset.theme); } catch { /* a private window */ }
  redraw();
}

/** Puts the frame up at once; what needs the session follows when it is known. */
export function shell(title) {
  document.title = title ? `${title} \u2013 Feedwright` : "Feedwright";
  // The bar itself is in the document, so that it is painted before any module is there.
  const bar = $(".topbar");
  bar.append(element(html`<nav class="nav" aria-label="${t("app.main")}">${pages.map(([id, path, sign, kind]) => html`<a href="${path}" class="${kind ?? ""}" ${id === name() ? html`aria-current="page"` : ""}>${icon(sign)}<span>${t(`nav.${id}`)}</span></a>`)}</nav>`), element(html`<div class="right">
      <span class="live" id="live" data-state="polled" role="status"><span class="dot"></span><span class="live-text"></span></span>
      <span class="who" id="who"></span>
      <button class="btn quiet" id="language" lang="${language === "de" ? "en" : "de"}" aria-label="${t("app.languageLabel")}">${t("app.language")}</button>
      <button class="btn quiet" id="theme" aria-label="${t("app.theme")}">${icon("sun")}</button>
      <a class="btn quiet phone-only" href="/settings" aria-label="${t("nav.settings")}" title="${t("nav.settings")}">${icon("more")}</a>
      <button class="btn quiet" id="sign-out" aria-label="${t("sign.out")}" title="${t("sign.out")}" hidden>${icon("out")}</button>
    </div>`));
  document.body.prepend(element(html`<a class="skip" href="#main">${t("app.skip")}</a>`));
  $("#theme").addEventListener("click", switchTheme);
  $("#language").addEventListener("click", () => setLanguage(language === "de" ? "en" : "de"));
  $("#sign-out").addEventListener("click", signOut);
  matchMedia("print").addEventListener("change", redraw);
  addEventListener("session", ({ detail: who }) => {
    $("#who").textContent = `${who.name}, ${t(`role.${who.role}`)}`;
    $("#sign-out").hidden = who.expires_at == null;
  });
  session().catch(() => {}); // the page itself asks too, says what is wrong, and tries again
}
/** Leaves only when the session is over: whoever believes to be signed out leaves the screen to the next one. */
async function signOut() {
  try { await ask("DELETE", "/v1/session"); } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status !== 401) {
      $("#not-out")?.remove();
      $("#main").prepend(element(html`<div id="not-out">${failure(error, t("sign.notOut"))}</div>`));
      return;
    }
  }
  location.replace("/sign-in");
}

/** Says how fresh the page is: live, polled, offline. */
export function freshness(state) {
  const node = $("#live");
  if (!node) return;
  if (node.dataset.state !== state) node.dataset.state = state;
  put($(".live-text", node), t(`live.${state}`));
}

/** Attributes and words of an action that the role may be closed for: visible, dashed, with the reason. */
export function action(who, route, label, { id, primary = false, sign, type = "button", kind = "" } = {}) {
  const open = may(who, route);
  const reason = open ? null : closedFor(who.role, route);
  return html`<button type="${type}" class="btn ${primary && open ? "primary" : ""} ${kind}" ${id ? html`id="${id}"` : ""} ${open ? "" : html`aria-disabled="true" title="${reason}" aria-description="${reason}"`}>${sign ? icon(sign) : ""}${label}</button>`;
}
export const closed = (button) => button.getAttribute("aria-disabled") === "true";
