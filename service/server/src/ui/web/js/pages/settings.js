import { $, $$, element, fill, html, put } from "../html.js";
import { icon } from "../icons.js";
import { action, closed, confirm_, shell } from "../shell.js";
import { empty, failure, notice, skeleton } from "../states.js";
import { ApiError, all, ask, get, may, post, segment, session } from "../api.js";
import { entered } from "../fields.js";
import { opening } from "../live.js";
import { date, moment, num, unit } from "../format.js";
import { t, told } from "../text.js";

const MOST = 5000, AUDIT_PAGE = 100, DETAIL = 160;
const references = ["unknown", "rated_power", "continuous_rating", "rated_torque", "maximum_current"];
const processes = ["friction", "drilling", "plunge", "turning", "vibratory", "milling"];
/** What a registration holds: path in the body, kind of input, unit. */
const KINDS = {
  machines: { route: "PUT /v1/machines/{machine}", path: "/v1/machines", columns: ["name", "control", "limits"], start: { ipo_period_ms: 10, spindle: { reference: "unknown" }, feed_drive: { reference: "unknown" }, limits: { feed_min_mm_min: 1, feed_max_mm_min: 5000, override_min_percent: 5, override_max_percent: 200 } }, fields: [
    ["name", "text"], ["control", "text"], ["ipo_period_ms", "number", "ms"], ["spindle.reference", references], ["spindle.rated_power_watts", "number", "W", 1], ["spindle.base_speed_rpm", "number", "rpm", 1], ["feed_drive.reference", references], ["feed_drive.rated_thrust_newtons", "number", "N", 1], ["limits.feed_min_mm_min", "number", "mm/min"], ["limits.feed_max_mm_min", "number", "mm/min"], ["limits.override_min_percent", "number", "%"], ["limits.override_max_percent", "number", "%"]] },
  tools: { route: "PUT /v1/tools/{tool}", path: "/v1/tools", columns: ["name", "tool_type", "diameter_mm"], start: {}, fields: [["name", "text"], ["tool_type", "text"], ["serial", "text", "", 1], ["diameter_mm", "number", "mm", 1]] },
  operations: { route: "PUT /v1/operations/{operation}", path: "/v1/operations", columns: ["name", "process", "loads"], start: { process: "friction" }, fields: [
    ["name", "text"], ["process", processes], ["program", "text", "", 1], ["feature", "text", "", 1], ["work_material", "text", "", 1], ["thickness_mm", "number", "mm", 1], ["depth_mm", "number", "mm", 1], ["spindle_speed_rpm", "number", "rpm", 1], ["programmed_feed_mm_min", "number", "mm/min", 1], ["feed_drive_load_set_percent", "number", "%", 1], ["spindle_load_set_percent", "number", "%", 1], ["wear.baseline_cycles", "number", "", 1], ["wear.window_cycles", "number", "", 1]] },
};
const TABS = ["machines", "tools", "operations", "alarms", "quarantine", "tokens", "audit"];
const asked = new URLSearchParams(location.search);
let who = null, tab = "machines";
const pick = (body, path) => path.split(".").reduce((at, name) => at?.[name], body);
function set(body, path, value) { const names = path.split("."), last = names.pop(); let at = body; for (const name of names) at = at[name] ??= {}; at[last] = value; }
const optionName = (path, value) => told(path.endsWith("reference") ? "reference" : path, value);
const fieldId = (path) => `f-${path.replaceAll(".", "-")}`;

async function registry(kind) {
  const spec = KINDS[kind], host = $("#panel"), { items, complete } = await all(spec.path, MOST);
  const cell = (one, column) => ({ limits: () => `${num(one.limits.override_min_percent)} ${t("to")} ${unit(one.limits.override_max_percent, "%")}`, diameter_mm: () => one.diameter_mm == null ? "" : unit(one.diameter_mm, "mm", 1), process: () => told("process", one.process), loads: () => [one.feed_drive_load_set_percent, one.spindle_load_set_percent].map((value) => value == null ? t("none") : unit(value, "%")).join(" / ") }[column] ?? (() => one[column] ?? ""))();
  fill(host, html`<div class="set-head"><p class="muted">${t(`set.${kind}What`)}</p>${action(who, spec.route, t(`set.${kind}Add`), { id: "add", primary: true })}</div><div id="said"></div><div id="form"></div>
    ${items.length ? html`<div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("tool.id")}</th>${spec.columns.map((column) => html`<th scope="col">${t(`set.col.${column}`)}</th>`)}<th scope="col" class="num">${t("set.version")}</th><th scope="col">${t("set.since")}</th><th scope="col"><span class="sr">${t("set.do")}</span></th></tr></thead><tbody>${items.map((one) => html`<tr><th scope="row">${one.id}</th>${spec.columns.map((column) => html`<td>${cell(one, column)}</td>`)}<td class="num">${num(one.version)}</td><td class="nowrap">${date(one.updated_at)}</td><td class="num">${action(who, spec.route, t("set.edit"), { kind: `quiet edit`, id: `edit-${one.id}` })}</td></tr>`)}</tbody></table></div>` : empty(t(`set.${kind}None`), t(`set.${kind}NoneText`))}
    ${complete ? "" : html`<p class="muted">${t("set.cut", { count: num(items.length) })}</p>`}`);
  $("#add").addEventListener("click", () => { if (!closed($("#add"))) edit(kind, null); });
  for (const button of $$(".edit", host)) button.addEventListener("click", () => { if (!closed(button)) edit(kind, button.id.slice(5)); });
  if (kind === "machines" && asked.get("machine")) { const id = asked.get("machine"); asked.delete("machine"); if (items.some((one) => one.id === id) && may(who, spec.route)) edit(kind, id); }
}
async function edit(kind, id) {
  const spec = KINDS[kind];
  let body = structuredClone(spec.start), etag = null;
  if (id) { const found = await ask("GET", `${spec.path}/${segment(id)}`); etag = found.etag; body = found.body; for (const name of ["id", "version", "updated_at"]) delete body[name]; }
  fill($("#form"), html`<form class="panel body set-form" id="edit" novalidate aria-labelledby="edit-h"><h2 id="edit-h">${id ? t("set.editing", { id }) : t(`set.${kind}Add`)}</h2><div class="set-fields">
    ${id ? "" : html`<div class="field"><label for="f-id">${t("tool.id")}</label><input type="text" id="f-id" required maxlength="128" spellcheck="false" autocapitalize="off"><p class="said" id="f-id-said"></p></div>`}
    ${spec.fields.map(([path, type, un, optional]) => html`<div class="field"><label for="${fieldId(path)}">${t(`field.${path}`)}${un ? html` <span class="unit">${un}</span>` : ""}${optional ? html` <span class="faint tiny">${t("set.optional")}</span>` : ""}</label>${Array.isArray(type) ? html`<select id="${fieldId(path)}">${type.map((value) => html`<option value="${value}" ${pick(body, path) === value ? html`selected` : ""}>${optionName(path, value)}</option>`)}</select>` : html`<input type="${type}" step="any" id="${fieldId(path)}" value="${pick(body, path) ?? ""}">`}<p class="said" id="${fieldId(path)}-said"></p></div>`)}</div>
    <div id="edit-said"></div><div class="knot-tools"><button class="btn primary" type="submit">${t("save")}</button><button class="btn" type="button" id="edit-cancel">${t("cancel")}</button></div></form>`);
  $("#edit input, #edit select").focus();
  $("#edit").scrollIntoView({ block: "nearest" });
  $("#edit-cancel").addEventListener("click", () => { fill($("#form"), ""); });
  $("#edit").addEventListener("submit", async (event) => {
    event.preventDefault();
    for (const said of $$("#edit .said")) said.textContent = "";
    for (const input of $$("#edit [aria-invalid]")) input.removeAttribute("aria-invalid");
    const next = structuredClone(body), name = id ?? $("#f-id").value.trim();
    fill($("#edit-said"), "");
    const numbers = spec.fields.filter(([, type]) => type === "number").map(([path]) => $(`#${fieldId(path)}`));
    if (!entered(numbers)) { fill($("#edit-said"), notice("act", t("set.notSaved", { id: name || t("set.new") }), t("set.lookAtFields"))); return; }
    if (!name) { say("id", t("set.idNeeded")); return; }
    for (const [path, type, , optional] of spec.fields) {
      const text = $(`#${fieldId(path)}`).value.trim();
      if (Array.isArray(type)) set(next, path, text);
      else if (text === "" && optional) { if (pick(next, path) !== undefined) set(next, path, null); }
      else set(next, path, type === "number" ? (text === "" ? null : Number(text)) : text);
    }
    if (next.wear && next.wear.baseline_cycles == null) delete next.wear.baseline_cycles;
    if (next.wear && next.wear.window_cycles == null) delete next.wear.window_cycles;
    try {
      await ask("PUT", `${spec.path}/${segment(name)}`, { body: next, etag, headers: etag ? {} : { "if-none-match": "*" } });
      await registry(kind);
      put($("#said"), notice("", t("set.saved", { id: name })));
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      let placed = 0;
      for (const one of error.errors) placed += say(one.path, one.message) ? 1 : 0;
      fill($("#edit-said"), failure(placed && placed === error.errors.length ? Object.assign(new ApiError(error.status, { code: "fields", detail: t("set.lookAtFields"), request_id: error.requestId })) : error, t("set.notSaved", { id: name })));
      $("#edit [aria-invalid]")?.focus();
    }
  });
}
function say(path, message) { const input = $(`#${fieldId(path)}`); if (!input) return false; input.setAttribute("aria-invalid", "true"); input.setAttribute("aria-describedby", `${input.id}-said`); $(`#${input.id}-said`).textContent = message; return true; }

async function alarms() {
  const { items } = await all("/v1/alarms?open=true", MOST);
  const recent = [...items].reverse();
  fill($("#panel"), html`<div class="set-head"><p class="muted">${t("set.alarmsWhat")}</p></div><div id="said"></div>${recent.length ? html`<div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("set.alarm")}</th><th scope="col">${t("col.machine")}</th><th scope="col">${t("col.tool")}</th><th scope="col">${t("set.says")}</th><th scope="col">${t("set.raised")}</th><th scope="col"><span class="sr">${t("set.do")}</span></th></tr></thead><tbody>${recent.map((one) => html`<tr><td><span class="flag ${["worn", "broken_suspected", "overload"].includes(one.kind) ? "act" : "plan"}">${icon(["worn", "broken_suspected", "overload"].includes(one.kind) ? "act" : "plan")}<span>${t(`alarm.${one.kind}`)}</span></span></td><td>${one.machine ?? ""}</td><td>${one.tool ? html`<a href="/tool?id=${segment(one.tool)}">${one.tool}</a>` : ""}</td><td class="wide">${one.message}</td><td class="nowrap">${moment(one.raised_at)}</td><td class="num">${one.acknowledged_by ? html`<span class="faint">${t("set.acknowledged")}</span>` : action(who, "POST /v1/alarms/{id}/acknowledge", t("set.acknowledge"), { kind: "quiet ack", id: `ack-${one.id}` })}</td></tr>`)}</tbody></table></div>` : empty(t("set.alarmsNone"), t("set.alarmsNoneText"))}`);
  for (const button of $$(".ack")) button.addEventListener("click", async () => { if (!closed(button)) await doing(async () => { await post(`/v1/alarms/${button.id.slice(4)}/acknowledge`, undefined); await alarms(); }); });
}
async function quarantine() {
  const { items } = await all("/v1/quarantine?open=true", 1000);
  fill($("#panel"), html`<div class="set-head"><p class="muted">${t("set.quarantineWhat")}</p></div><div id="said"></div>${items.length ? html`<div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("col.machine")}</th><th scope="col">${t("nav.cycle")}</th><th scope="col">${t("set.why")}</th><th scope="col" class="num">${t("set.size")}</th><th scope="col">${t("set.received")}</th><th scope="col"><span class="sr">${t("set.do")}</span></th></tr></thead><tbody>${items.map((one) => html`<tr><th scope="row">${one.machine}</th><td>${one.cycle_id ?? ""}</td><td class="wide"><b>${one.code}</b> ${one.problem?.detail ?? ""}</td><td class="num nowrap">${one.size_bytes == null ? "" : unit(one.size_bytes / 1024, "KiB", 1)}</td><td class="nowrap">${moment(one.received_at)}</td><td class="num nowrap">${action(who, "POST /v1/quarantine/{id}", t("set.discard"), { kind: "quiet settle", id: `settle-${one.id}` })}</td></tr>`)}</tbody></table></div>` : empty(t("set.quarantineNone"), t("set.quarantineNoneText"))}`);
  for (const button of $$(".settle")) button.addEventListener("click", () => { if (!closed(button)) confirm_(t("set.discardTitle"), t("set.discardText"), t("set.discard"), async (reason) => { await post(`/v1/quarantine/${segment(button.id.slice(7))}`, { action: "discard", reason }); await quarantine(); }, true); });
}
async function tokens() {
  if (!may(who, "GET /v1/tokens")) { fill($("#panel"), notice("", t("closed.title"), t("closed", { role: t(`role.${who.role}`), who: t("role.admin") }))); return; }
  const [{ items }, machines] = await Promise.all([all("/v1/tokens", MOST), all("/v1/machines", MOST)]);
  fill($("#panel"), html`<div class="set-head"><p class="muted">${t("set.tokensWhat")}</p></div><div id="said"></div>
    <form class="panel body set-form" id="make" aria-labelledby="make-h"><h2 id="make-h">${t("set.tokensAdd")}</h2><div class="set-fields"><div class="field"><label for="f-name">${t("field.name")}</label><input type="text" id="f-name" maxlength="200"><p class="said" id="f-name-said"></p></div><div class="field"><label for="f-role">${t("set.role")}</label><select id="f-role">${["viewer", "engineer", "approver", "admin", "machine"].map((role) => html`<option value="${role}">${t(`role.${role}`)}</option>`)}</select><p class="said" id="f-role-said"></p></div><div class="field" id="of-machine" hidden><label for="f-machine">${t("col.machine")}</label><select id="f-machine">${machines.items.map((one) => html`<option>${one.id}</option>`)}</select><p class="said" id="f-machine-said"></p></div></div><div id="edit-said"></div><div class="knot-tools"><button class="btn primary" type="submit">${t("set.make")}</button></div></form>
    <div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("field.name")}</th><th scope="col">${t("set.role")}</th><th scope="col">${t("col.machine")}</th><th scope="col">${t("tool.id")}</th><th scope="col">${t("set.made")}</th><th scope="col"><span class="sr">${t("set.do")}</span></th></tr></thead><tbody>${[...items].sort((a, b) => Boolean(a.revoked_at) - Boolean(b.revoked_at) || b.id.localeCompare(a.id)).map((one) => html`<tr class="${one.revoked_at ? "gone" : ""}"><th scope="row">${one.name}</th><td>${t(`role.${one.role}`)}</td><td>${one.machine ?? ""}</td><td><code>${one.id}</code></td><td class="nowrap">${date(one.created_at)}</td><td class="num nowrap">${one.revoked_at ? html`<span class="faint">${t("set.revokedAt", { date: date(one.revoked_at) })}</span>` : html`<button class="btn quiet revoke" data-name="${one.name}" id="revoke-${one.id}">${t("set.revoke")}</button>`}</td></tr>`)}</tbody></table></div>`);
  $("#f-role").addEventListener("change", (event) => { $("#of-machine").hidden = event.target.value !== "machine"; });
  $("#make").addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      const role = $("#f-role").value, made = await post("/v1/tokens", { name: $("#f-name").value.trim(), role, machine: role === "machine" ? $("#f-machine").value : null });
      await tokens();
      put($("#said"), notice("", t("set.tokenMade", { name: made.name }), t("set.tokenOnce"), html`<p class="token"><code id="new-token">${made.token}</code> <button class="btn" id="copy">${t("set.copy")}</button></p>`));
      $("#copy").addEventListener("click", async () => { try { await navigator.clipboard.writeText(made.token); $("#copy").textContent = t("set.copied"); } catch { getSelection().selectAllChildren($("#new-token")); } });
    } catch (error) { if (!(error instanceof ApiError)) throw error; for (const one of error.errors) say(one.path, one.message); fill($("#edit-said"), failure(error)); }
  });
  for (const button of $$(".revoke")) button.addEventListener("click", () => confirm_(t("set.revokeTitle", { name: button.dataset.name }), t("set.revokeText"), t("set.revoke"), async () => { await ask("DELETE", `/v1/tokens/${segment(button.id.slice(7))}`); await tokens(); }));
}
/** Long ones are folded, not cut: what was changed can be read to the end. */
const detail = (text) => text.length <= DETAIL ? html`<code>${text}</code>` : html`<details class="whole"><summary><code>${text.slice(0, DETAIL)}\u2026</code> <span>${t("set.detailWhole")}</span></summary><code>${text}</code></details>`;
async function audit() {
  const line = (one) => html`<tr><td class="nowrap">${moment(one.at)}</td><td><code class="nowrap">${one.actor}</code>${names.get(one.actor) ? html`<span class="w">${names.get(one.actor)}</span>` : ""}</td><td>${t(`role.${one.role}`)}</td><td class="nowrap">${one.action}</td><td class="name">${one.subject}</td><td class="wide">${detail(JSON.stringify(one.detail))}</td></tr>`;
  const names = new Map(may(who, "GET /v1/tokens") ? (await all("/v1/tokens", MOST)).items.map((one) => [one.id, one.name]) : []);
  let cursor = null;
  const older = async () => {
    const page = await get(`/v1/audit?order=newest&limit=${AUDIT_PAGE}${cursor ? `&cursor=${segment(cursor)}` : ""}`);
    cursor = page.next_cursor ?? null;
    $("#lines").insertAdjacentHTML("beforeend", String(html`${page.items.map(line)}`));
    $("#older").hidden = !cursor;
    put($("#shown"), t("set.auditShown", { count: num($("#lines").rows.length) }));
  };
  fill($("#panel"), html`<div class="set-head"><p class="muted">${t("set.auditWhat")}</p></div><div id="said"></div><div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("set.when")}</th><th scope="col">${t("set.who")}</th><th scope="col">${t("set.role")}</th><th scope="col">${t("set.did")}</th><th scope="col">${t("set.of")}</th><th scope="col">${t("set.detail")}</th></tr></thead><tbody id="lines"></tbody></table></div><div class="knot-tools"><button class="btn" id="older" hidden>${t("set.auditOlder")}</button><span class="muted small" id="shown" role="status"></span></div>`);
  $("#older").addEventListener("click", () => doing(older));
  await older();
}
async function doing(work) { try { await work(); } catch (error) { if (!(error instanceof ApiError)) throw error; fill($("#said"), failure(error)); } }

const shows = { machines: () => registry("machines"), tools: () => registry("tools"), operations: () => registry("operations"), alarms, quarantine, tokens, audit };
async function show() {
  const wanted = location.hash.slice(1);
  tab = TABS.includes(wanted) ? wanted : "machines";
  for (const link of $$("#tabs a")) if (link.hash === `#${tab}`) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  fill($("#panel"), skeleton(5));
  try { await shows[tab](); } catch (error) { if (!(error instanceof ApiError)) throw error; fill($("#panel"), failure(error, t("error.load"))); }
}
shell(t("nav.settings"));
fill($("#main"), html`<div class="head"><div class="titles"><h1>${t("nav.settings")}</h1></div><div class="tools"><a class="btn" href="/studies">${t("nav.studies")}</a><a class="btn" href="/docs/">${t("set.api")}</a></div></div><nav class="tabs" id="tabs" aria-label="${t("nav.settings")}">${TABS.map((name) => html`<a href="#${name}">${t(`set.${name}`)}</a>`)}</nav><section class="panel body" id="panel" aria-live="off">${skeleton(5)}</section>`);
addEventListener("hashchange", show);
await opening(async () => { who = await session(); await show(); }, (error) => fill($("#panel"), failure(error, t("error.load"))));
