import { $, fill, html } from "../html.js";
import { t } from "../text.js";

// Nothing of it needs a session: whoever mistyped an address is not asked to sign in for that.
document.title = `${t("unknown.title")} \u2013 Feedwright`;
fill($("#main"), html`<section class="sign panel">
  <h1>${t("unknown.title")}</h1>
  <p class="muted">${t("unknown.text")}</p>
  <p><code>${location.pathname}</code></p>
  <p><a class="btn primary" href="/">${t("unknown.go")}</a></p>
</section>`);
