// Buttons that ask the server for something: once at a time, and with the answer beside them where it is a refusal.
import { element, html } from "./html.js";
import { icon } from "./icons.js";
import { ApiError } from "./api.js";
import { told, t } from "./text.js";

/** Does `work` while the button is closed and says so: pressed twice it would be done twice. */
export async function busy(button, work) {
  if (button.getAttribute("aria-busy") === "true") return undefined;
  const focused = document.activeElement === button;
  button.setAttribute("aria-busy", "true");
  button.disabled = true;
  try { return await work(); } finally {
    button.removeAttribute("aria-busy");
    button.disabled = false;
    // A closed button has lost the focus.
    if (focused && button.isConnected && document.activeElement === document.body) button.focus();
  }
}
/** The same for a button without a place of its own for words: what fails is told right after it. */
export function act(button, work) {
  const before = button.parentNode.querySelector(":scope > .beside");
  return busy(button, async () => {
    try { before?.remove(); await work(); } catch (error) {
      if (error.name === "AbortError") return;
      if (!(error instanceof ApiError)) throw error;
      button.after(element(html`<p class="flag act beside" role="alert">${icon("act")}<span>${t("error.title")}: ${told("problem", error.code, error.message)}</span></p>`));
    }
  });
}

const both = ["engineer", "admin"];
const steps = { approve: ["approver"], activate: ["engineer", "approver", "admin"], rollback: ["engineer", "approver", "admin"] };
/** Why a route is closed for a role, and for whom it is not. */
export const closedFor = (role, route) => t("closed", { role: t(`role.${role}`), who: (route.includes("/v1/tokens") ? ["admin"] : steps[route.split("/").at(-1)] ?? both).map((one) => t(`role.${one}`)).join(", ") });
