import { $, $$, fill, html, put } from "../html.js";
import { icon } from "../icons.js";
import { act, busy, closedFor } from "../actions.js";
import { confirm } from "../dialog.js";
import { guard, mayLeave } from "../leave.js";
import { action, closed, shell } from "../shell.js";
import { empty, failure, notice, skeleton } from "../states.js";
import { ApiError, all, ask, get, may, post, segment, session } from "../api.js";
import { entered, number, numeric, refused, right, touched, untouched, wrong, written } from "../fields.js";
import { keep, opening } from "../live.js";
import { date, moment, num, unit } from "../format.js";
import { t, told } from "../text.js";

const BEAT_MS = 15_000, MOST = 5000, MOST_KEPT = 1000, AUDIT_PAGE = 100, DETAIL = 160;
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
/** `visit` ends when another tab is shown: what is answered later is not written there. `refresh` reads this tab's list again. */
let who = null, tab = "machines", visit = new AbortController(), refresh = null;
const pick = (body, path) => path.split(".").reduce((at, name) => at?.[name], body);
function set(body, path, value) { const names = path.split("."), last = names.pop(); let at = body; for (const name of names) at = at[name] ??= {}; at[last] = value; }
const optionName = (path, value) => told(path.endsWith("reference") ? "reference" : path, value);
const fieldId = (path) => `f-${path.replaceAll(".", "-")}`;

const table = (head, rows, acts = true) => html`<div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set ${acts ? "acts" : ""}"><thead><tr>${head}</tr></thead><tbody>${rows}</tbody></table></div>`;
const doing = html`<th scope="col"><span class="sr">${t("set.do")}</span></th>`;
/** Why the actions of a tab are closed, in words: a title is seen by a mouse only. */
const shut = (route) => may(who, route) ? "" : html`<p class="muted small shut">${closedFor(who.role, route)}</p>`;

/** Shows a tab: its frame, and in it the list that `read` gives, which is read again on the page's beat and after a change. */
async function listing(frame, read) {
  const { signal } = visit, first = await read(signal);
  signal.throwIfAborted();
  fill($("#panel"), html`${frame}<div id="list"></div>`);
  put($("#list"), first);
  refresh = async () => {
    try {
      const now = await read(signal), focused = $("#list").contains(document.activeElement) && document.activeElement.id;
      signal.throwIfAborted();
      if (put($("#list"), now) && focused) document.getElementById(focused)?.focus();
    } catch (error) { if (!signal.aborted) throw error; }
  };
}
/** Says what was done and reads the list again; that it cannot be read just now undoes nothing. */
async function did(signal, what) {
  if (signal.aborted) return;
  if (what) fill($("#said"), what);
  try { await refresh?.(); } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    $("#said").insertAdjacentHTML("beforeend", String(failure(error, t("error.load"))));
  }
}
/** That there is more than a list shows; what is settled makes room for it. */
const cut = (items, complete, key = "set.cut") => complete ? "" : html`<p class="muted">${t(key, { count: num(items.length) })}</p>`;

async function registry(kind) {
  const spec = KINDS[kind];
  const cell = (one, column) => ({ limits: () => `${num(one.limits.override_min_percent)} ${t("to")} ${unit(one.limits.override_max_percent, "%")}`, diameter_mm: () => one.diameter_mm == null ? "" : unit(one.diameter_mm, "mm", 1), process: () => told("process", one.process), loads: () => [one.feed_drive_load_set_percent, one.spindle_load_set_percent].map((value) => value == null ? t("none") : unit(value, "%")).join(" / ") }[column] ?? (() => one[column] ?? ""))();
  const head = html`<th scope="col">${t("tool.id")}</th>${spec.columns.map((column) => html`<th scope="col">${t(`set.col.${column}`)}</th>`)}<th scope="col" class="num">${t("set.version")}</th><th scope="col">${t("set.since")}</th>${doing}`;
  let known = [];
  await listing(html`<div class="set-head"><p class="muted">${t(`set.${kind}What`)}</p>${action(who, spec.route, t(`set.${kind}Add`), { id: "add", kind: "add", primary: true })}</div>${shut(spec.route)}<div id="said"></div><div id="form"></div>`, async (signal) => {
    const { items, complete } = await all(spec.path, MOST, { signal });
    known = items;
    return html`${items.length ? table(head, items.map((one) => html`<tr><th scope="row">${one.id}</th>${spec.columns.map((column) => html`<td>${cell(one, column)}</td>`)}<td class="num">${num(one.version)}</td><td class="nowrap">${date(one.updated_at)}</td><td class="num">${action(who, spec.route, t("set.edit"), { kind: `quiet edit`, id: `edit-${one.id}` })}</td></tr>`)) : empty(t(`set.${kind}None`), t(`set.${kind}NoneText`))}
    ${cut(items, complete)}`;
  });
  const id = kind === "machines" ? asked.get("machine") : null;
  asked.delete("machine");
  if (known.some((one) => one.id === id) && may(who, spec.route)) await act(document.getElementById(`edit-${id}`), () => edit(id));
}
/** What is registered, as a form changes it. */
async function current(spec, id, signal) {
  const { body, etag } = await ask("GET", `${spec.path}/${segment(id)}`, { signal }), { version } = body;
  for (const name of ["id", "version", "updated_at"]) delete body[name];
  return { body, etag, version };
}
const inField = (body, path, type) => type === "number" ? written(pick(body, path)) : pick(body, path) ?? (Array.isArray(type) ? type[0] : "");
const alike = (a, b, type) => a.trim() === b.trim() || (type === "number" && number(a) === number(b));
async function edit(id) {
  const { signal } = visit, kind = tab, spec = KINDS[kind];
  if (!await mayLeave()) return;
  let { body, etag } = id ? await current(spec, id, signal) : { body: structuredClone(spec.start), etag: null };
  signal.throwIfAborted();
  fill($("#form"), html`<form class="panel body set-form" id="edit" novalidate aria-labelledby="edit-h"><h2 id="edit-h">${id ? t("set.editing", { id }) : t(`set.${kind}Add`)}</h2><div class="set-fields">
    ${id ? "" : html`<div class="field"><label for="f-id">${t("tool.id")}</label><input type="text" id="f-id" required maxlength="128" spellcheck="false" autocapitalize="off"><p class="said" id="f-id-said"></p></div>`}
    ${spec.fields.map(([path, type, un, optional]) => html`<div class="field"><label for="${fieldId(path)}">${t(`field.${path}`)}${un ? html` <span class="unit">${un}</span>` : ""}${optional ? html` <span class="faint tiny">${t("set.optional")}</span>` : ""}</label>${Array.isArray(type) ? html`<select id="${fieldId(path)}">${type.map((value) => html`<option value="${value}" ${pick(body, path) === value ? html`selected` : ""}>${optionName(path, value)}</option>`)}</select>` : type === "number" ? numeric(fieldId(path), pick(body, path), optional ? "" : html`required`) : html`<input type="${type}" id="${fieldId(path)}" value="${pick(body, path) ?? ""}">`}<p class="said" id="${fieldId(path)}-said"></p></div>`)}</div>
    <div id="edit-said"></div><div class="knot-tools"><button class="btn primary" type="submit">${t("save")}</button><button class="btn" type="button" id="edit-cancel">${t("cancel")}</button></div></form>`);
  const form = $("#edit"), of = (path) => document.getElementById(path === /\{(\w+)\}/.exec(spec.route)[1] ? "f-id" : fieldId(path));
  untouched(form);
  $("input, select", form).focus();
  form.scrollIntoView({ block: "nearest" });
  $("#edit-cancel").addEventListener("click", () => { fill($("#form"), ""); });
  form.addEventListener("submit", (event) => { event.preventDefault(); busy($("[type=submit]", form), save); });
  async function save() {
    for (const input of $$("input, select", form)) right(input, document.getElementById(`${input.id}-said`));
    fill($("#edit-said"), "");
    const next = structuredClone(body), name = id ?? $("#f-id").value.trim(), title = t("set.notSaved", { id: name || t("set.new") });
    if (!entered(spec.fields.filter(([, type]) => type === "number").map(([path]) => of(path)))) { fill($("#edit-said"), notice("act", title, t("set.lookAtFields"))); return; }
    if (!name) { wrong($("#f-id"), $("#f-id-said"), t("set.idNeeded")); $("#f-id").focus(); return; }
    for (const [path, type, , optional] of spec.fields) {
      const text = of(path).value.trim();
      if (Array.isArray(type)) set(next, path, text);
      else if (text === "" && optional) { if (pick(next, path) !== undefined) set(next, path, null); }
      else set(next, path, type === "number" ? number(text) : text);
    }
    if (next.wear && next.wear.baseline_cycles == null) delete next.wear.baseline_cycles;
    if (next.wear && next.wear.window_cycles == null) delete next.wear.window_cycles;
    try {
      await ask("PUT", `${spec.path}/${segment(name)}`, { body: next, etag, headers: etag ? {} : { "if-none-match": "*" } });
      if (form.isConnected) fill($("#form"), "");
      await did(signal, notice("", t("set.saved", { id: name })));
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (!form.isConnected) return;
      if (error.status !== 412) fill($("#edit-said"), refused(error, of, title));
      else if (etag) await conflict().catch((later) => { if (signal.aborted) return; if (!(later instanceof ApiError)) throw later; fill($("#edit-said"), failure(later, title)); });
      else { wrong($("#f-id"), $("#f-id-said"), t("set.exists")); $("#f-id").focus(); fill($("#edit-said"), notice("act", title, t("set.lookAtFields"))); }
    }
  }
  /** Somebody else was faster: what was typed stays, beside what is in force, and saving again puts it in its place. */
  async function conflict() {
    const found = await current(spec, id, signal);
    for (const [path, type] of spec.fields) {
      const field = of(path), was = inField(body, path, type), now = inField(found.body, path, type);
      if (alike(field.value, was, type)) field.value = now;
      else if (!alike(field.value, now, type) && was !== now) wrong(field, document.getElementById(`${field.id}-said`), t("set.other", { value: now === "" ? t("set.nothing") : Array.isArray(type) ? optionName(path, now) : now }));
    }
    ({ body, etag } = found);
    fill($("#edit-said"), notice("plan", t("set.conflict", { n: found.version }), t("set.conflictText")));
    $("[aria-invalid]", form)?.focus();
  }
}

function alarms() {
  const route = "POST /v1/alarms/{id}/acknowledge", head = html`<th scope="col">${t("set.alarm")}</th><th scope="col">${t("col.machine")}</th><th scope="col">${t("col.tool")}</th><th scope="col">${t("set.says")}</th><th scope="col">${t("set.raised")}</th>${doing}`;
  return listing(html`<div class="set-head"><p class="muted">${t("set.alarmsWhat")}</p></div>${shut(route)}<div id="said"></div>`, async (signal) => {
    const { items, complete } = await all("/v1/alarms?open=true", MOST, { signal }), recent = items.reverse();
    return recent.length ? html`${cut(recent, complete, "set.more")}${table(head, recent.map((one) => html`<tr><td><span class="flag ${["worn", "broken_suspected", "overload"].includes(one.kind) ? "act" : "plan"}">${icon(["worn", "broken_suspected", "overload"].includes(one.kind) ? "act" : "plan")}<span>${t(`alarm.${one.kind}`)}</span></span></td><td>${one.machine ?? ""}</td><td>${one.tool ? html`<a href="/tool?id=${segment(one.tool)}">${one.tool}</a>` : ""}</td><td class="wide">${one.message}</td><td class="nowrap">${moment(one.raised_at)}</td><td class="num">${one.acknowledged_by ? html`<span class="faint">${t("set.acknowledged")}</span>` : action(who, route, t("set.acknowledge"), { kind: "quiet ack", id: `ack-${one.id}` })}</td></tr>`))}` : empty(t("set.alarmsNone"), t("set.alarmsNoneText"));
  });
}
function quarantine() {
  const route = "POST /v1/quarantine/{id}", head = html`<th scope="col">${t("col.machine")}</th><th scope="col">${t("nav.cycle")}</th><th scope="col">${t("set.why")}</th><th scope="col" class="num">${t("set.size")}</th><th scope="col">${t("set.received")}</th>${doing}`;
  return listing(html`<div class="set-head"><p class="muted">${t("set.quarantineWhat")}</p></div>${shut(route)}<div id="said"></div>`, async (signal) => {
    const { items, complete } = await all("/v1/quarantine?open=true", MOST_KEPT, { signal });
    return items.length ? html`${cut(items, complete, "set.more")}${table(head, items.map((one) => html`<tr><th scope="row">${one.machine}</th><td>${one.cycle_id ?? ""}</td><td class="wide"><b>${one.code}</b> ${one.problem?.detail ?? ""}</td><td class="num nowrap">${one.size_bytes == null ? "" : unit(one.size_bytes / 1024, "KiB", 1)}</td><td class="nowrap">${moment(one.received_at)}</td><td class="num nowrap">${action(who, route, t("set.discard"), { kind: "quiet settle", id: `settle-${one.id}` })}</td></tr>`))}` : empty(t("set.quarantineNone"), t("set.quarantineNoneText"));
  });
}
/** A token that was made and is not shown yet: it is alive, and shown once. */
let made = null;
function tellToken() {
  const { name, token } = made;
  made = null;
  fill($("#said"), notice("", t("set.tokenMade", { name }), t("set.tokenOnce"), html`<p class="token"><code id="new-token">${token}</code> <button class="btn" id="copy">${t("set.copy")}</button></p>`));
  $("#copy").addEventListener("click", async () => { try { await navigator.clipboard.writeText(token); $("#copy").textContent = t("set.copied"); } catch { getSelection().selectAllChildren($("#new-token")); } });
}
async function tokens() {
  if (!may(who, "GET /v1/tokens")) { fill($("#panel"), notice("", t("closed.title"), closedFor(who.role, "GET /v1/tokens"))); return; }
  const { signal } = visit, machines = await all("/v1/machines", MOST, { signal }), head = html`<th scope="col">${t("field.name")}</th><th scope="col">${t("set.role")}</th><th scope="col">${t("col.machine")}</th><th scope="col">${t("tool.id")}</th><th scope="col">${t("set.made")}</th>${doing}`;
  await listing(html`<div class="set-head"><p class="muted">${t("set.tokensWhat")}</p></div><div id="said"></div>
    <form class="panel body set-form" id="make" novalidate aria-labelledby="make-h"><h2 id="make-h">${t("set.tokensAdd")}</h2><div class="set-fields"><div class="field"><label for="f-name">${t("field.name")}</label><input type="text" id="f-name" maxlength="200"><p class="said" id="f-name-said"></p></div><div class="field"><label for="f-role">${t("set.role")}</label><select id="f-role">${["viewer", "engineer", "approver", "admin", "machine"].map((role) => html`<option value="${role}">${t(`role.${role}`)}</option>`)}</select><p class="said" id="f-role-said"></p></div><div class="field" id="of-machine" hidden><label for="f-machine">${t("col.machine")}</label><select id="f-machine">${machines.items.map((one) => html`<option>${one.id}</option>`)}</select><p class="said" id="f-machine-said"></p></div></div><div id="edit-said"></div><div class="knot-tools"><button class="btn primary" type="submit">${t("set.make")}</button></div></form>`, async (signal) => {
    const { items, complete } = await all("/v1/tokens", MOST, { signal });
    return html`${cut(items, complete, "set.more")}${table(head, items.sort((a, b) => Boolean(a.revoked_at) - Boolean(b.revoked_at) || b.id.localeCompare(a.id)).map((one) => html`<tr class="${one.revoked_at ? "gone" : ""}"><th scope="row">${one.name}</th><td>${t(`role.${one.role}`)}</td><td>${one.machine ?? ""}</td><td><code>${one.id}</code></td><td class="nowrap">${date(one.created_at)}</td><td class="num nowrap">${one.revoked_at ? html`<span class="faint">${t("set.revokedAt", { date: date(one.revoked_at) })}</span>` : html`<button class="btn quiet revoke" data-name="${one.name}" id="revoke-${one.id}">${t("set.revoke")}</button>`}</td></tr>`))}`;
  });
  const form = $("#make"), role = $("#f-role"), ofMachine = () => { $("#of-machine").hidden = role.value !== "machine"; };
  untouched(form);
  if (made) tellToken();
  role.addEventListener("change", ofMachine);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    busy($("[type=submit]", form), async () => {
      for (const input of $$("input, select", form)) right(input, document.getElementById(`${input.id}-said`));
      fill($("#edit-said"), "");
      try {
        made = await post("/v1/tokens", { name: $("#f-name", form).value.trim(), role: role.value, machine: role.value === "machine" ? $("#f-machine", form).value : null });
        if (signal.aborted) return;
        form.reset();
        ofMachine();
        tellToken();
        await did(signal);
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        if (!signal.aborted) fill($("#edit-said"), refused(error, (path) => document.getElementById(fieldId(path)), t("set.notSaved", { id: t("set.new") })));
      }
    });
  });
}
/** Long ones are folded, not cut: what was changed can be read to the end. */
const detail = (text) => text.length <= DETAIL ? html`<code>${text}</code>` : html`<details class="whole"><summary><code>${text.slice(0, DETAIL)}\u2026</code> <span>${t("set.detailWhole")}</span></summary><code>${text}</code></details>`;
async function audit() {
  const { signal } = visit;
  const line = (one) => html`<tr><td class="nowrap">${moment(one.at)}</td><td><code class="nowrap">${one.actor}</code>${names.get(one.actor) ? html`<span class="w">${names.get(one.actor)}</span>` : ""}</td><td>${t(`role.${one.role}`)}</td><td class="nowrap">${one.action}</td><td class="name">${one.subject}</td><td class="wide">${detail(JSON.stringify(one.detail))}</td></tr>`;
  const names = new Map(may(who, "GET /v1/tokens") ? (await all("/v1/tokens", MOST, { signal })).items.map((one) => [one.id, one.name]) : []);
  let cursor = null;
  const older = async () => {
    const page = await get(`/v1/audit?order=newest&limit=${AUDIT_PAGE}${cursor ? `&cursor=${segment(cursor)}` : ""}`, { signal });
    cursor = page.next_cursor ?? null;
    $("#lines").insertAdjacentHTML("beforeend", String(html`${page.items.map(line)}`));
    $("#older").hidden = !cursor;
    put($("#shown"), t("set.auditShown", { count: num($("#lines").rows.length) }));
  };
  fill($("#panel"), html`<div class="set-head"><p class="muted">${t("set.auditWhat")}</p></div><div id="said"></div><div class="scroll" tabindex="0" role="region" aria-label="${t("app.table")}"><table class="set"><thead><tr><th scope="col">${t("set.when")}</th><th scope="col">${t("set.who")}</th><th scope="col">${t("set.role")}</th><th scope="col">${t("set.did")}</th><th scope="col">${t("set.of")}</th><th scope="col">${t("set.detail")}</th></tr></thead><tbody id="lines"></tbody></table></div><div class="knot-tools"><button class="btn" id="older" hidden>${t("set.auditOlder")}</button><span class="muted small" id="shown" role="status"></span></div>`);
  $("#older").addEventListener("click", ({ currentTarget }) => act(currentTarget, older));
  await older();
}

/** What the buttons of the lists do, by their class; each names its row in its id. */
const presses = {
  add: () => edit(null),
  edit: (id) => edit(id),
  ack: async (id, { signal }) => { await post(`/v1/alarms/${id}/acknowledge`, undefined); await did(signal); },
  settle: async (id, { signal }) => { if (await confirm({ title: t("set.discardTitle"), text: t("set.discardText"), reason: t("tool.reason"), label: t("set.discard"), work: (reason) => post(`/v1/quarantine/${segment(id)}`, { action: "discard", reason }) })) await did(signal); },
  revoke: async (id, { signal }, { name }) => { if (await confirm({ title: t("set.revokeTitle", { name }), text: t("set.revokeText"), label: t("set.revoke"), work: () => ask("DELETE", `/v1/tokens/${segment(id)}`) })) await did(signal); },
};
function pressed({ target }) {
  const button = target.closest("button"), name = button && Object.keys(presses).find((one) => button.classList.contains(one));
  if (name && !closed(button)) act(button, () => presses[name](button.id.slice(name.length + 1), visit, button.dataset));
}
const shows = { machines: () => registry("machines"), tools: () => registry("tools"), operations: () => registry("operations"), alarms, quarantine, tokens, audit };
async function show() {
  visit.abort();
  const mine = visit = new AbortController(), wanted = location.hash.slice(1);
  tab = TABS.includes(wanted) ? wanted : "machines";
  refresh = null;
  for (const link of $$("#tabs a")) if (link.hash === `#${tab}`) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
  fill($("#panel"), skeleton(5));
  try { await shows[tab](); } catch (error) {
    if (mine.signal.aborted) return;
    if (!(error instanceof ApiError)) throw error;
    fill($("#panel"), failure(error, t("error.load")));
    refresh = () => shows[tab]().catch((later) => { if (!mine.signal.aborted) throw later; });
  }
}
/** Another tab, unless somebody stays for what is not saved. */
async function turn() {
  if (await mayLeave()) await show(); else history.replaceState(null, "", `#${tab}`);
}
shell(t("nav.settings"));
fill($("#main"), html`<div class="head"><div class="titles"><h1>${t("nav.settings")}</h1></div><div class="tools"><a class="btn" href="/studies">${t("nav.studies")}</a><a class="btn" href="/docs/">${t("set.api")}</a></div></div><nav class="tabs" id="tabs" aria-label="${t("nav.settings")}">${TABS.map((name) => html`<a href="#${name}">${t(`set.${name}`)}</a>`)}</nav><section class="panel body" id="panel" aria-live="off">${skeleton(5)}</section>`);
$("#panel").addEventListener("click", pressed);
guard(() => $$("#panel form").some(touched));
addEventListener("hashchange", turn);
addEventListener("session", ({ detail }) => { who = detail; });
await opening(async () => { who = await session(); await show(); }, (error) => fill($("#panel"), failure(error, t("error.load"))));
// Not while something is asked about a line of the list, or done with it.
keep(async () => { if (!$("dialog[open], #panel [aria-busy=true]:not(.skeleton)")) await refresh?.(); }, BEAT_MS, { drawn: true });
