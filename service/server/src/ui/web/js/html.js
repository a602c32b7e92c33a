// HTML out of templates: whatever is put into one is escaped, unless it is HTML itself.
class Html { constructor(text) { this.text = text; } toString() { return this.text; } }

const escapes = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;" };
export const escape = (value) => String(value).replace(/[&<>"']/g, (c) => escapes[c]);
const shown = (value) => value == null || value === false ? "" : Array.isArray(value) ? value.map(shown).join("") : value instanceof Html ? value.text : escape(value);

/** html`<b>${anything}</b>` */
export const html = (parts, ...values) => new Html(parts.reduce((text, part, i) => text + part + (i < values.length ? shown(values[i]) : ""), ""));
/** Text that is HTML by our own hand, such as an icon. Never of data. */
export const trusted = (text) => new Html(text);

export const $ = (selector, root = document) => root.querySelector(selector);
export const $$ = (selector, root = document) => [...root.querySelectorAll(selector)];
export const fill = (node, content) => { node.innerHTML = shown(content); return node; };
export const element = (content) => { const template = document.createElement("template"); template.innerHTML = shown(content).trim(); return template.content.firstElementChild; };
/** Puts text into a node only where it differs, so that a page that is live does not repaint for nothing. */
export const put = (node, content) => { const text = shown(content); if (node.kept !== text) { node.kept = text; node.innerHTML = text; return true; } return false; };
