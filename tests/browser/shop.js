// A shop for the browser: a server of its own in a temporary folder, with a simulated fleet and tokens of every role.
import { execFile, spawn } from "node:child_process";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { promisify } from "node:util";

const BINARY = process.env.FEEDWRIGHT_BINARY ?? new URL("../../target/debug/feedwright", import.meta.url).pathname;
const run = promisify(execFile);

export class Shop {
  static async open({ machines = 8, cycles = 130 } = {}) {
    const shop = new Shop();
    shop.dir = await mkdtemp(join(tmpdir(), "feedwright-browser-"));
    shop.server = spawn(BINARY, ["--data-dir", shop.dir, "--set", "server.listen=127.0.0.1:0", "--set", "log.level=warn", "serve"]);
    process.once("exit", () => shop.server.kill("SIGKILL"));
    for (const signal of ["SIGINT", "SIGTERM"]) process.once(signal, () => process.exit(1));
    shop.log = "";
    for (const stream of [shop.server.stdout, shop.server.stderr]) stream.on("data", (text) => { shop.log += text; });
    shop.address = `http://${await shop.listening()}`;
    shop.admin = /fwt_[0-9a-f]+_[0-9a-f]+_[0-9a-f]+/.exec(shop.log)[0];
    await shop.fill(machines, cycles);
    return shop;
  }
  async listening() {
    for (let patience = 200; patience > 0; patience--) {
      // The lock names the address once the listener is there, and nothing before that.
      const lock = await readFile(join(this.dir, "feedwright.lock"), "utf8").catch(() => "");
      const address = /127\.0\.0\.1:\d+/.exec(lock)?.[0];
      if (address && this.log.includes("fwt_") && (await fetch(`http://${address}/readyz`).catch(() => null))?.ok) return address;
      if (this.server.exitCode != null) throw new Error(`the server ended: ${this.log}`);
      await new Promise((wake) => setTimeout(wake, 50));
    }
    throw new Error(`the server does not answer: ${this.log}`);
  }
  async ask(method, path, body, headers = {}) {
    const answer = await fetch(this.address + path, { method, headers: { authorization: `Bearer ${this.admin}`, ...(body === undefined ? {} : { "content-type": "application/json" }), ...headers }, body: body === undefined ? undefined : JSON.stringify(body) });
    const text = await answer.text();
    if (!answer.ok) throw new Error(`${method} ${path}: ${answer.status} ${text}`);
    return { body: text ? JSON.parse(text) : null, etag: answer.headers.get("etag") };
  }
  async fill(machines, cycles) {
    await run(BINARY, ["simulate", "--server", this.address, "--machines", String(machines), "--cycles", String(cycles), "--life", "100", "--seed", "7", "--faults", "air_cut,thickness,nan_body", "--fault-share", "0.02"], { env: { ...process.env, FEEDWRIGHT_TOKEN: this.admin } });
    const { body, etag } = await this.ask("GET", "/v1/operations/sim-bushing");
    for (const name of ["id", "version", "updated_at"]) delete body[name];
    await this.ask("PUT", "/v1/operations/sim-bushing", { ...body, name: "Cross member, M8 bushing", feed_drive_load_set_percent: 34, spindle_load_set_percent: 40 }, { "if-match": etag });
    await this.ask("PUT", "/v1/models/plunge/c45-hss", { name: "C45, HSS", thrust: { coefficient: 680, diameter_exponent: 1, feed_exponent: 0.7, correction: 1 }, torque: { coefficient: 345, diameter_exponent: 2, feed_exponent: 0.8, correction: 1 } });
    const machine = { name: "Mill 1", control: "sinumerik-840d", ipo_period_ms: 10, spindle: { reference: "rated_power", rated_power_watts: 7000 }, feed_drive: { reference: "unknown" }, limits: { feed_min_mm_min: 1, feed_max_mm_min: 5000, override_min_percent: 5, override_max_percent: 200 } };
    await this.ask("PUT", "/v1/machines/new-1", { ...machine, name: "Not yet running" });
    await this.ask("PUT", "/v1/machines/dense-1", { ...machine, name: "Recorded at 10 kHz" });
    await this.ask("PUT", "/v1/tools/dense-tool", { name: "Drill", tool_type: "d8" });
    await this.ask("POST", "/v1/machines/dense-1/cycles", dense(60_000));
    this.tokens = { admin: this.admin };
    for (const role of ["viewer", "engineer", "approver"]) this.tokens[role] = (await this.ask("POST", "/v1/tokens", { name: `${role} of the shop`, role })).body.token;
  }
  /** One more cycle of a machine, as its control would report it. */
  report(machine, tool, energy, id) { return this.ask("POST", `/v1/machines/${machine}/cycles`, { cycle_id: id, tool, operation: "sim-bushing", started_at: new Date().toISOString(), reported: { energy_joules: energy, duration_ms: 4280 } }); }
  async close() {
    this.server.kill("SIGTERM");
    await new Promise((ended) => { if (this.server.exitCode != null) ended(); else this.server.once("exit", ended); });
    await rm(this.dir, { recursive: true, force: true });
  }
}

/** A cycle of so many samples whose shape is known: a spike of one sample has to be seen at every zoom. */
export function dense(samples) {
  const wave = (i) => 20 + 12 * Math.sin(i / samples * 9) + 3 * Math.sin(i * 0.37);
  const column = (of) => Array.from({ length: samples }, (_, i) => +of(i).toFixed(3));
  return {
    cycle_id: "dense", tool: "dense-tool", operation: "sim-bushing", started_at: new Date().toISOString(), spindle_speed_rpm: 2800,
    samples: { period_ms: 0.1, depth_mm: column((i) => -0.5 + i / samples * 20.5), feed_actual_mm_min: column(() => 205), override_percent: column(() => 100), feed_drive_load_percent: column(wave), spindle_load_percent: column((i) => i === 31_234 ? 93 : wave(i + 900)) },
  };
}
