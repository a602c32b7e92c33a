// Every check of the pages in a browser. Runs them one after the other, says what each took, and fails with all that failed.
import assert from "node:assert/strict";
import { mkdir, readdir, readFile } from "node:fs/promises";
import { Browser, heap, violations } from "./browser.js";
import { Shop } from "./shop.js";

const SHOTS = new URL("../../target/browser/", import.meta.url).pathname;
const WEB = new URL("../../service/server/src/ui/web/", import.meta.url).pathname;
const ONLY = process.argv[2];
const failed = [];
let shop, browser;
async function check(name, work) {
  if (ONLY && !name.includes(ONLY)) return;
  const begun = performance.now();
  try { await work(); console.log(`ok    ${name} (${((performance.now() - begun) / 1000).toFixed(1)} s)`); } catch (error) { failed.push(name); console.log(`FAIL  ${name}\n${error.stack ?? error}`); }
}
const nothingWrong = (page) => assert.deepEqual(page.wrong, []);
async function withPage(options, work) { const page = await browser.page(shop, options); try { await work(page); nothingWrong(page); } finally { await page.finish(); } }

const PAGES = { fleet: "/", wall: "/?view=wall", cycle: "/cycle?machine=sim-4", tool: "/tool?id=sim-tool-1", profile: "/profile", next: "/next?machine=sim-1", strategies: "/studies", turning: "/studies#turning", plunge: "/studies#plunge", machines: "/settings", operations: "/settings#operations", alarms: "/settings#alarms", quarantine: "/settings#quarantine", tokens: "/settings#tokens", audit: "/settings#audit", "sign-in": "/sign-in" };
const SIZES = { desktop: { width: 1440, height: 900 }, phone: { width: 390, height: 844 } };

await check("texts: both languages have the same keys, and every key that is used", async () => {
  global.document = { documentElement: { lang: "en" } };
  const [{ en }, { de }] = await Promise.all([import(`${WEB}js/words/en.js`), import(`${WEB}js/words/de.js`)]);
  assert.deepEqual(Object.keys(en).sort(), Object.keys(de).sort());
  for (const key of Object.keys(en)) assert.equal(typeof en[key], typeof de[key], key);
  let used = 0;
  for (const folder of ["js", "js/pages"]) for (const name of (await readdir(WEB + folder)).filter((one) => one.endsWith(".js"))) {
    const text = await readFile(`${WEB}${folder}/${name}`, "utf8");
    for (const [, key] of text.matchAll(/\bt\("([^"]+)"/g)) { assert.ok(key in en, `${name} uses ${key}`); used += 1; }
    assert.ok(!/\bstyle="|onclick=/.test(text), `${name} writes a style or a handler inline`);
  }
  assert.ok(used > 300, `only ${used} uses were found`);
});

await check("tracks: what a zoom shows is the minimum and maximum of every pixel column", async () => {
  const { Track, forward } = await import(`${WEB}js/track.js`);
  const count = 60_000, x = Array.from({ length: count }, (_, i) => i * 0.01), y = x.map((value, i) => Math.sin(value) + (i * 7919 % 1000) / 1000);
  const track = new Track(x, { y });
  let seed = 1;
  const random = (below) => { seed = seed * 48271 % 2147483647; return seed % below; };
  for (let turn = 0; turn < 100; turn++) {
    const from = random(count - 1), to = from + 1 + random(count - from - 1), part = y.slice(from, to);
    assert.deepEqual(track.extremes("y", from, to), [part.reduce((a, b) => Math.min(a, b)), part.reduce((a, b) => Math.max(a, b))]);
  }
  for (const [min, max] of [[0, 600], [100, 101], [250, 400]]) {
    let drawn = 0, low = Infinity, high = -Infinity;
    track.each("y", min, max, 1000, (_, a, b) => { drawn += 1; low = Math.min(low, a); high = Math.max(high, b); });
    const inside = y.filter((_, i) => x[i] >= min && x[i] <= max);
    assert.ok(low <= inside.reduce((a, b) => Math.min(a, b)) && high >= inside.reduce((a, b) => Math.max(a, b)), "a peak is missing");
    assert.ok(drawn <= 2010, `${drawn} columns for 1000 pixels`);
  }
  const holed = new Track([0, 1, 2, 3], { y: [1, null, 3, 4] });
  assert.equal(holed.at("y", 1), null);
  assert.equal(holed.at("y", 2.5), 3.5);
  assert.equal(holed.at("y", 9), null);
  assert.deepEqual(forward([-2, -1, 0, 1, 0.5, 2], -1.5), [1, 2, 3, 5]);
});

if (!ONLY || !["texts", "tracks"].some((name) => ONLY.startsWith(name))) {
  await mkdir(SHOTS, { recursive: true });
  [shop, browser] = await Promise.all([Shop.open(), Browser.open()]);
  console.log(`a shop with ${(await shop.ask("GET", "/v1/machines?limit=1000")).body.items.length} machines at ${shop.address}`);
}

await check("sign-in: a wrong token is told and stays, a good one goes on to where one wanted to be", async () => {
  await withPage({ role: null, expects: ["401", "403"] }, async (page) => {
    await page.goto(`${shop.address}/tool?id=sim-tool-2`);
    await page.waitForURL(/sign-in\?next=/);
    await page.settled();
    await page.keyboard.type("fwt_wrong");
    await page.keyboard.press("Enter");
    await page.getByText("This is no token of Feedwright").waitFor();
    assert.equal(await page.locator("#token").inputValue(), "fwt_wrong", "what was entered is kept");
    await page.locator("#token").fill(shop.tokens.viewer);
    await page.keyboard.press("Enter");
    await page.waitForURL(/\/tool\?id=sim-tool-2/);
    await page.settled();
    const [cookie] = (await page.context().cookies()).filter((one) => one.name === "feedwright_session");
    assert.deepEqual([cookie.httpOnly, cookie.sameSite, cookie.path], [true, "Strict", "/"]);
    assert.equal(await page.evaluate(() => document.cookie), "", "no script can read it");
    assert.match(await page.locator("#who").textContent(), /viewer/);
    await page.locator("#sign-out").click();
    await page.waitForURL(/sign-in/);
    await page.goto(shop.address);
    await page.waitForURL(/sign-in/);
  });
  await withPage({ role: null }, async (page) => {
    for (const next of ["//evil.example", "https://evil.example", "/\\evil.example"]) {
      await page.goto(`${shop.address}/sign-in?next=${encodeURIComponent(next)}`);
      await page.settled();
      await page.locator("#token").fill(shop.tokens.viewer);
      await page.keyboard.press("Enter");
      await page.waitForFunction(() => document.body.dataset.page === "fleet");
      assert.ok(page.url().startsWith(shop.address), page.url());
      await page.context().clearCookies();
    }
  });
});

for (const [size, box] of Object.entries(SIZES)) for (const theme of ["light", "dark"]) for (const language of ["en-GB", "de-DE"]) {
  const name = `${size} ${theme} ${language.slice(0, 2)}`;
  await check(`pages: ${name}: no violation, no error, no breach of the policy, nothing wider than the screen`, async () => {
    await withPage({ ...box, theme, language }, async (page) => {
      const found = [];
      for (const [id, path] of Object.entries(PAGES)) {
        if (id === "wall" && size === "phone") continue;
        await page.goto("about:blank");
        await page.go(path).catch((error) => { throw new Error(`${id}: ${error.message} ${page.wrong.join("; ")}`); });
        if (id === "turning" || id === "plunge" || id === "strategies") await page.locator("#answer table").first().waitFor({ state: "attached" });
        assert.equal(await page.evaluate(() => document.documentElement.lang), language.slice(0, 2));
        assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), theme);
        found.push(...(await violations(page)).map((text) => `${id}: ${text}`));
        const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        if (wide > 1) found.push(`${id}: ${wide} px wider than the screen`);
        await page.screenshot({ path: `${SHOTS}${id}-${size}-${theme}-${language.slice(0, 2)}.png` });
      }
      assert.deepEqual(found, []);
    });
  });
}

await check("pages: a wide screen and a tablet hold them too", async () => {
  for (const [width, height] of [[3840, 2160], [1024, 768]]) await withPage({ width, height }, async (page) => {
    for (const id of ["fleet", "cycle", "tool", "next"]) {
      await page.go(PAGES[id]);
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth) <= 1, `${id} at ${width}`);
      await page.screenshot({ path: `${SHOTS}${id}-${width}.png` });
    }
  });
});

await check("fleet: sorted by keyboard, filtered, found; and it shows a cycle that comes in", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    await page.go("/");
    const names = () => page.locator("#rows tr:visible .c-name").allTextContents();
    await page.locator("th[data-sort=name] button").focus();
    await page.keyboard.press("Enter");
    const ascending = await names();
    assert.deepEqual(ascending, [...ascending].sort((a, b) => a.localeCompare(b, undefined, { numeric: true })));
    assert.equal(await page.locator("th[data-sort=name]").getAttribute("aria-sort"), "ascending");
    await page.keyboard.press("Enter");
    assert.deepEqual(await names(), [...ascending].reverse());
    await page.locator("#find").fill("sim-3");
    assert.deepEqual(await names(), ["sim-3"]);
    await page.locator("#find").fill("nothing like it");
    await page.getByText("No machine matches.").waitFor();
    await page.locator("#find").fill("");
    await page.locator("#chips button[value=none]").click();
    assert.deepEqual(await names(), ["new-1"]);
    await page.locator("#chips button[value=all]").click();
    const before = await names();
    await page.waitForFunction(() => document.querySelector("#live").dataset.state === "live");
    const row = page.locator("#rows tr", { has: page.locator("a", { hasText: /^sim-2$/ }) });
    await shop.report("sim-2", "sim-tool-2", 1234, "live-1");
    await row.locator(".c-energy", { hasText: /1.234/ }).waitFor();
    assert.deepEqual(await names(), before, "no row moves by itself");
  });
});

await check("fleet: hundreds of machines are drawn and refreshed without lag", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    const real = (await shop.ask("GET", "/v1/fleet?limit=100")).body;
    const many = { ...real, items: Array.from({ length: 600 }, (_, i) => ({ ...real.items[i % real.items.length], machine: `m-${i + 1}` })) };
    await page.route("**/v1/fleet?*", (route) => route.fulfill({ json: many }));
    await page.go("/");
    assert.equal(await page.locator("#rows tr").count(), 600);
    const spent = await page.evaluate(async () => {
      const sort = document.querySelector("#sort"), times = [];
      for (const value of ["name", "left", "attention"]) { const begun = performance.now(); sort.value = value; sort.dispatchEvent(new Event("change")); document.querySelector("#rows").offsetHeight; times.push(performance.now() - begun); }
      return times;
    });
    console.log(`      sorting 600 machines: ${spent.map((ms) => `${ms.toFixed(0)} ms`).join(", ")}`);
    await page.go("/?view=wall");
    const places = () => page.locator(".tile h2").allTextContents();
    const first = await places();
    assert.equal(first.length, 600);
    many.items.reverse();
    await page.evaluate(() => document.dispatchEvent(new Event("visibilitychange")));
    await page.waitForTimeout(300);
    assert.deepEqual(await places(), first, "tiles never change their place");
  });
});

await check("cycle: zoomed, panned and read by keyboard; compared with the new tool and with what if", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    await page.go("/cycle?machine=sim-4");
    const charts = page.locator("#charts"), at = () => page.locator("#at").textContent();
    await charts.focus();
    const first = await at();
    await page.keyboard.press("ArrowRight");
    assert.notEqual(await at(), first, "the cursor moves");
    const widths = () => page.evaluate(() => [...document.querySelectorAll("#charts .hair")].map((hair) => hair.style.transform));
    const placed = await widths();
    assert.ok(placed.length >= 4 && new Set(placed).size === 1, `one line through all rows: ${placed}`);
    for (let i = 0; i < 6; i++) await page.keyboard.press("+");
    await page.keyboard.press("Shift+ArrowRight");
    await page.screenshot({ path: `${SHOTS}cycle-zoomed.png` });
    await page.keyboard.press("Escape");
    assert.equal(await page.locator("#stages tr").count(), 4, "stages A to D");
    await page.locator("#compare button[value=new]").click();
    await page.locator("#refkey svg").waitFor();
    assert.match(await page.locator("#refkey").textContent(), /tool when new/);
    assert.match(await page.locator("#read tr").first().textContent(), /[+\u2212\d]/);
    await page.locator("#compare button[value=whatif]").click();
    await page.locator("#wi-trust dl").waitFor();
    await page.locator("#wi-spindle").fill("60");
    await page.locator("#wi-form button").click();
    await page.getByText(/limits 44.% and 60.%|limits \d+.% and 60.%/).first().waitFor();
    await page.screenshot({ path: `${SHOTS}cycle-whatif.png` });
    await page.locator("#xaxis button[value=t]").click();
    assert.match(await page.locator("#xname").textContent(), /Time/);
    assert.deepEqual(await violations(page), []);
  });
});

await check("cycle: 60 000 samples, where a spike of one sample is seen at every zoom", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    await page.go("/cycle?machine=dense-1");
    const measured = await page.evaluate(async () => {
      const charts = document.querySelector("#charts"), press = (key, shiftKey) => charts.dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey, bubbles: true }));
      const frame = () => new Promise((wake) => requestAnimationFrame(wake));
      for (let i = 0; i < 4; i++) { press("+"); await frame(); }
      const work = [], gaps = [];
      let last = await frame();
      for (let i = 0; i < 90; i++) { const begun = performance.now(); press(i % 30 < 15 ? "ArrowRight" : "ArrowLeft", true); await Promise.resolve(); await Promise.resolve(); work.push(performance.now() - begun); const now = await frame(); gaps.push(now - last); last = now; }
      const middle = (list) => [...list].sort((a, b) => a - b)[list.length >> 1];
      return { work: middle(work), gap: middle(gaps) };
    });
    console.log(`      panning 60 000 samples: ${measured.work.toFixed(1)} ms of work a frame, a frame every ${measured.gap.toFixed(1)} ms (median)`);
    await page.keyboard.press("Escape");
    assert.match(await page.locator("#figures").textContent(), /93/, "the highest spindle load is the spike");
    await page.screenshot({ path: `${SHOTS}cycle-dense.png` });
    const paints = await page.evaluate(() => performance.getEntriesByName("first-contentful-paint")[0]?.startTime);
    console.log(`      first contentful paint after ${paints?.toFixed(0)} ms`);
  });
});

await check("tool: who may records an event, who may not is told why", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    await page.go("/tool?id=sim-tool-5");
    const record = page.locator("#record");
    assert.equal(await record.getAttribute("aria-disabled"), "true");
    assert.match(await record.getAttribute("title"), /viewer.*process engineer/);
    await record.click({ force: true });
    assert.equal(await page.locator("dialog[open]").count(), 0);
  });
  await withPage({ role: "engineer" }, async (page) => {
    await page.go("/tool?id=sim-tool-5");
    await page.locator("#record").click();
    await page.locator("#event-kind").selectOption("reset");
    await page.locator("#event-form button[type=submit]").click();
    await page.locator("#event-said .notice").waitFor();
    await page.locator("#event-kind").selectOption("reground");
    await page.locator("#event-reason").fill("ground at the maker's");
    assert.deepEqual(await violations(page), []);
    await page.locator("#event-form button[type=submit]").click();
    await page.getByText("Recorded. It holds from the next cycle on.").waitFor();
    await page.locator("#events", { hasText: "ground at the maker's" }).waitFor();
    page.wrong = page.wrong.filter((text) => !text.includes("422"));
    page.wrong.length = 0;
  });
});

await check("settings: a bad value is marked at its field and kept; a token is shown once", async () => {
  await withPage({ role: "admin", expects: ["422"] }, async (page) => {
    await page.go("/settings#tools");
    await page.locator("#add").click();
    await page.locator("#f-id").fill("T 1");
    await page.locator("#f-name").fill("Drill 8");
    await page.locator("#f-tool_type").fill("d8");
    await page.locator("#f-diameter_mm").fill("-3");
    await page.locator("#edit button[type=submit]").click();
    await page.locator("#edit-said .notice").waitFor();
    assert.equal(await page.locator("#f-diameter_mm").inputValue(), "-3", "kept");
    await page.locator("#f-id").fill("T-1");
    await page.locator("#edit button[type=submit]").click();
    await page.locator("#f-diameter_mm[aria-invalid=true]").waitFor();
    assert.ok((await page.locator("#f-diameter_mm-said").textContent()).length > 5);
    assert.deepEqual(await violations(page), []);
    await page.locator("#f-diameter_mm").fill("8");
    await page.locator("#edit button[type=submit]").click();
    await page.getByText("T-1 is saved").waitFor();
    await page.locator("[id='edit-T-1']").click();
    await page.locator("#f-name").fill("Drill 8, long");
    await page.locator("#edit button[type=submit]").click();
    await page.getByText("Drill 8, long").waitFor();
    await page.go("/settings#tokens");
    await page.locator("#f-name").fill("tablet at the drill");
    await page.locator("#make button").click();
    assert.match(await page.locator("#new-token").textContent(), /^fwt_/);
    await page.go("/settings#audit");
    await page.getByText("token.create").first().waitFor();
    assert.ok(!(await page.content()).includes("new-token"));
  });
  await withPage({ role: "viewer" }, async (page) => {
    await page.go("/settings#tokens");
    await page.getByText("You can look, not change").waitFor();
    await page.go("/settings#machines");
    assert.equal(await page.locator("#add").getAttribute("aria-disabled"), "true");
  });
});

await check("offline: said with its time, and taken back by itself", async () => {
  await withPage({ role: "viewer", expects: ["ERR_", "Failed to load"] }, async (page) => {
    await page.go("/");
    await page.route("**/v1/fleet?*", (route) => route.abort());
    await page.getByText(/No connection to the server since/).waitFor();
    assert.ok(await page.locator("#rows tr").count() > 5, "what was known stays");
    await page.unroute("**/v1/fleet?*");
    await page.locator("#offline").waitFor({ state: "detached" });
  });
});

await check("a day of events in a minute: the pages stay live without growing", async () => {
  await withPage({ role: "viewer" }, async (page) => {
    const machines = (await shop.ask("GET", "/v1/fleet?limit=100")).body.items.filter((one) => one.last_cycle);
    const event = (id, name, data) => `id: x-${id}\nevent: ${name}\ndata: ${JSON.stringify(data)}\n\n`;
    // 8 machines with a cycle every 20 s make 34 560 cycles a day; of the one that is watched come samples too.
    const day = (n) => { let text = "retry: 3600000\n\n" + event(0, "state", { machines: [] }); for (let i = 0; i < n; i++) { const one = machines[i % machines.length], last = one.last_cycle; text += event(i + 1, "machine", { machine: one.machine, state: "running", at: new Date().toISOString(), cycle_id: `c${i}`, tool: last.tool, operation: last.operation }); if (one.machine === "sim-4") for (let k = 0; k < 20; k++) text += `event: sample\ndata: ${JSON.stringify({ machine: "sim-4", cycle_id: `c${i}`, sample: k, time_ms: k * 10, depth_mm: k / 10, spindle_load_percent: 20 + k % 7, feed_drive_load_percent: 15, override_percent: 100 })}\n\n`; text += event(i + 1, "cycle", { machine: one.machine, cycle_id: `c${i}`, tool: last.tool, operation: last.operation, received_at: new Date().toISOString(), started_at: new Date().toISOString() }); } return text; };
    const feed = day(34_560);
    for (const [name, path] of [["fleet", "/"], ["cycle", "/cycle?machine=sim-4"], ["next", "/next?machine=sim-1"]]) {
      let events = "retry: 3600000\n\n" + event(0, "state", { machines: [] });
      await page.route("**/v1/live*", (route) => route.fulfill({ contentType: "text/event-stream", body: events }));
      await page.goto("about:blank");
      await page.go(path);
      await page.waitForTimeout(300);
      const nodes = () => page.evaluate(() => document.querySelectorAll("*").length);
      const before = [await heap(page), await nodes()];
      events = feed;
      // The same page listens again, to a whole day of events at once.
      const seen = await page.evaluate(async () => { let count = 0; const source = new EventSource("/v1/live?again"); source.addEventListener("cycle", () => { count += 1; }); await new Promise((ended) => source.addEventListener("error", ended, { once: true })); source.close(); return count; });
      assert.equal(seen, 34_560, "every event was read");
      await page.unroute("**/v1/live*");
      await page.route("**/v1/live*", (route) => route.fulfill({ contentType: "text/event-stream", body: feed }));
      await page.goto("about:blank");
      await page.go(path);
      await page.waitForTimeout(4000);
      const after = [await heap(page), await nodes()];
      console.log(`      ${name}: heap ${(before[0] / 1e6).toFixed(1)} MB before, ${(after[0] / 1e6).toFixed(1)} MB after a day of events; ${before[1]} and ${after[1]} nodes`);
      assert.ok(after[0] < before[0] * 1.5 + 6e6, `the heap of ${name} grows: ${before[0]} to ${after[0]}`);
      assert.ok(after[1] < before[1] + 400, `the document of ${name} grows: ${before[1]} to ${after[1]}`);
      await page.unroute("**/v1/live*");
    }
    page.wrong.splice(0, page.wrong.length, ...page.wrong.filter((text) => !text.includes("404")));
  });
});

await browser?.close();
await shop?.close();
if (failed.length) { console.log(`\n${failed.length} failed: ${failed.join("; ")}`); process.exit(1); }
