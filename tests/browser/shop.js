// A shop for the browser: a server of its own in a temporary folder, with a simulated fleet, tokens of every role, a feed
// profile in three versions, and what nobody hopes for: names of all kinds, a cycle of one sample, gaps, a wrong clock.
import { execFile, spawn } from "node:child_process";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { promisify } from "node:util";
import { Stream } from "./stream.js";

const BINARY = process.env.FEEDWRIGHT_BINARY ?? new URL("../../target/debug/feedwright", import.meta.url).pathname;
const run = promisify(execFile);
export const OPERATION = "sim-bushing-100";
export const HOSTILE = `<img src=x onerror="document.title='broken'"><b>Drill</b> & "Sons" \u202Eevil\u202C \u05DE\u05E7\u05D3\u05D7\u05D4 \uD83D\uDD29\uD83D\uDC77\u200D\u2640\uFE0F ${"Langername".repeat(9)}`;

export class Shop {
  static async open({ machines = 8, cycles = 130, odd = true, faults = "air_cut,thickness,nan_body" } = {}) {
    const shop = new Shop();
    shop.dir = await mkdtemp(join(tmpdir(), "feedwright-browser-"));
    shop.listen = "127.0.0.1:0";
    process.once("exit", () => shop.server?.kill("SIGKILL"));
    for (const signal of ["SIGINT", "SIGTERM"]) process.once(signal, () => process.exit(1));
    await shop.start();
    shop.admin = /fwt_[0-9a-f]+_[0-9a-f]+_[0-9a-f]+/.exec(shop.log)[0];
    if (machines > 0) await shop.fill(machines, cycles, odd, faults); else shop.tokens = { admin: shop.admin };
    return shop;
  }
  /** Starts the server; a second time on the address that the pages know. */
  async start() {
    this.log = "";
    this.server = spawn(BINARY, ["--data-dir", this.dir, "--set", `server.listen=${this.listen}`, "--set", "log.level=warn", "--set", "server.failed_auth_per_minute=1000", "--set", "live.heartbeat_ms=1000", "serve"]);
    for (const stream of [this.server.stdout, this.server.stderr]) stream.on("data", (text) => { this.log += text; });
    this.address = `http://${await this.listening()}`;
    this.listen = this.address.slice(7);
  }
  async listening() {
    const late = Date.now() + 180_000;
    for (;;) {
      // The lock names the address once the listener is there, and nothing before that.
      const lock = await readFile(join(this.dir, "feedwright.lock"), "utf8").catch(() => "");
      const address = /127\.0\.0\.1:\d+/.exec(lock)?.[0];
      if (address && (this.admin || this.log.includes("fwt_")) && (await fetch(`http://${address}/readyz`).catch(() => null))?.ok) return address;
      if (this.server.exitCode != null) throw new Error(`the server ended: ${this.log}`);
      if (Date.now() > late) throw new Error(`the server does not answer: ${this.log}`);
      await new Promise((wake) => setTimeout(wake, 50));
    }
  }
  async stop(signal = "SIGTERM") {
    const ended = new Promise((done) => { if (this.server.exitCode != null || this.server.signalCode != null) done(); else this.server.once("exit", done); });
    this.server.kill(signal);
    await ended;
  }
  async ask(method, path, body, headers = {}, token = this.admin) {
    const answer = await fetch(this.address + path, { method, headers: { authorization: `Bearer ${token}`, ...(body === undefined ? {} : { "content-type": "application/json" }), ...headers }, body: body === undefined ? undefined : JSON.stringify(body) });
    const text = await answer.text();
    if (!answer.ok) throw new Error(`${method} ${path}: ${answer.status} ${text}`);
    return { body: text ? JSON.parse(text) : null, etag: answer.headers.get("etag") };
  }
  async fill(machines, cycles, withOdd, faults) {
    this.tokens = { admin: this.admin };
    for (const role of ["viewer", "engineer", "approver"]) this.tokens[role] = (await this.ask("POST", "/v1/tokens", { name: `${role} of the shop`, role })).body.token;
    await run(BINARY, ["simulate", "--server", this.address, "--machines", String(machines), "--cycles", String(cycles), "--life", "100", "--seed", "7", "--faults", faults, "--fault-share", "0.02"], { env: { ...process.env, FEEDWRIGHT_TOKEN: this.admin } });
    const { body, etag } = await this.ask("GET", `/v1/operations/${OPERATION}`);
    for (const name of ["id", "version", "updated_at"]) delete body[name];
    await this.ask("PUT", `/v1/operations/${OPERATION}`, { ...body, name: "Cross member, M8 bushing" }, { "if-match": etag });
    await this.ask("PUT", "/v1/models/plunge/c45-hss", { name: "C45, HSS", thrust: { coefficient: 680, diameter_exponent: 1, feed_exponent: 0.7, correction: 1 }, torque: { coefficient: 345, diameter_exponent: 2, feed_exponent: 0.8, correction: 1 } });
    if (withOdd) await this.odd();
    await this.profile();
  }
  /** What nobody hopes for. */
  async odd() {
    const machine = { name: "Mill 1", control: "sinumerik-840d", ipo_period_ms: 10, spindle: { reference: "rated_power", rated_power_watts: 7000 }, feed_drive: { reference: "unknown" }, limits: { feed_min_mm_min: 1, feed_max_mm_min: 5000, override_min_percent: 5, override_max_percent: 200 } };
    await this.ask("PUT", "/v1/machines/new-1", { ...machine, name: "Not yet running" });
    await this.ask("PUT", "/v1/machines/dense-1", { ...machine, name: "Recorded at 10 kHz" });
    await this.ask("PUT", "/v1/machines/odd-1", { ...machine, name: HOSTILE });
    await this.ask("PUT", "/v1/tools/dense-tool", { name: "Drill", tool_type: "d8" });
    await this.ask("PUT", "/v1/tools/odd-tool", { name: HOSTILE, tool_type: "d8" });
    await this.ask("PUT", "/v1/tools/new-tool", { name: "Never used", tool_type: "d8" });
    await this.ask("PUT", "/v1/operations/odd-op", { name: HOSTILE, process: "drilling" });
    await this.ask("POST", "/v1/machines/dense-1/cycles", dense(60_000));
    const odd = (id, samples) => this.ask("POST", "/v1/machines/odd-1/cycles", { cycle_id: id, tool: "odd-tool", operation: "odd-op", started_at: new Date().toISOString(), samples });
    await odd("gaps", gaps());
    await odd("one", { period_ms: 10, spindle_load_percent: [12.5] });
  }
  /** A feed profile in three versions: one that was in force, one that is, and a draft. */
  async profile() {
    const knots = (factor) => [[0, 105], [3, 155], [7, 535], [12, 205], [14.5, 545], [17.5, 545], [20.5, 345]].map(([depth_mm, feed]) => ({ depth_mm, feed_mm_min: Math.round(feed * factor) }));
    const draft = async (factor, reason, based_on) => (await this.ask("POST", "/v1/feed-profiles", { profile: "cross-member", reason, ...(based_on ? { based_on } : {}), content: { operation: OPERATION, tool_type: "fd-7.3", knots: knots(factor), sections: [{ kind: "heating", to_mm: 3 }, { kind: "forming", to_mm: 13 }, { kind: "idle_travel", to_mm: 18 }, { kind: "flange", to_mm: 20.5 }], limits: { feed_min_mm_min: 50, feed_max_mm_min: 800, acceleration_mm_s2: 300, override_min_percent: 20, override_max_percent: 150, spindle_load_set_percent: 40, feed_drive_load_set_percent: 30 }, wear: { to_level: 1.1 } } }, {}, this.tokens.engineer)).body.version;
    for (const [factor, reason] of [[0.85, "F_Lin of the trial of 12 May, careful"], [1, "F_Lin of the trial of 12 May"]]) {
      const version = await draft(factor, reason, factor === 1 ? 1 : undefined);
      await this.step("shadow", version, "engineer");
      await this.step("approve", version, "approver");
      await this.step("activate", version, "approver");
    }
    await draft(1.08, "A little faster between 4 and 10 mm", 2);
  }
  async step(step, version, role) {
    const { etag } = await this.ask("GET", "/v1/feed-profiles/cross-member");
    await this.ask("POST", `/v1/feed-profiles/cross-member/${step}`, { version }, { "if-match": etag }, this.tokens[role]);
  }
  /** One more cycle of a machine, as its control would report it. */
  report(machine, tool, energy, id, { operation = OPERATION, started_at = new Date().toISOString() } = {}) { return this.ask("POST", `/v1/machines/${machine}/cycles`, { cycle_id: id, tool, operation, started_at, reported: { energy_joules: energy, duration_ms: 4280 } }); }
  /** A machine's own stream, with a token of its own. */
  async stream(machine) {
    const { body } = await this.ask("POST", "/v1/tokens", { name: `stream of ${machine}`, role: "machine", machine });
    return Stream.open(this.address, machine, body.token);
  }
  async close() {
    await this.stop();
    await rm(this.dir, { recursive: true, force: true });
  }
}

/** A cycle of so many samples whose shape is known: a spike of one sample has to be seen at every zoom. */
export function dense(samples) {
  const wave = (i) => 20 + 12 * Math.sin(i / samples * 9) + 3 * Math.sin(i * 0.37);
  const column = (of) => Array.from({ length: samples }, (_, i) => +of(i).toFixed(3));
  return {
    cycle_id: "dense", tool: "dense-tool", operation: "odd-op", started_at: new Date().toISOString(), spindle_speed_rpm: 2800,
    samples: { period_ms: 0.1, depth_mm: column((i) => -0.5 + i / samples * 20.5), feed_actual_mm_min: column(() => 205), override_percent: column(() => 100), feed_drive_load_percent: column(wave), spindle_load_percent: column((i) => i === 31_234 ? 93 : wave(i + 900)) },
  };
}
/** Samples with holes in time, as a machine leaves them that did not measure for a while. */
function gaps() {
  const time_ms = [], depth_mm = [], spindle_load_percent = [];
  for (let i = 0; i < 900; i++) { if (i % 150 > 110) continue; time_ms.push(i * 10); depth_mm.push(+(i / 50 - 1).toFixed(3)); spindle_load_percent.push(+(15 + 10 * Math.sin(i / 90)).toFixed(2)); }
  return { time_ms, depth_mm, spindle_load_percent };
}
