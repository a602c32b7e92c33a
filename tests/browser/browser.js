// Chromium with what every check needs: a session, and an ear for everything that must not happen.
import { chromium } from "playwright-core";
import { readFile } from "node:fs/promises";

const axe = await readFile(new URL("node_modules/axe-core/axe.min.js", import.meta.url), "utf8");

export class Browser {
  static async open() { const browser = new Browser(); browser.chromium = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-dev-shm-usage", "--enable-precise-memory-info"] }); return browser; }
  /** A page in its own window; `wrong` fills with every console error, exception, failed request and breach of the policy. */
  async page(shop, { role = "admin", width = 1440, height = 900, theme = "light", language = "en-GB", expects = [] } = {}) {
    const context = await this.chromium.newContext({ viewport: { width, height }, colorScheme: theme, locale: language, timezoneId: "Europe/Berlin", hasTouch: width < 1000, reducedMotion: "reduce" });
    if (role) {
      const answer = await context.request.post(`${shop.address}/v1/session`, { data: { token: shop.tokens[role] }, headers: { "x-feedwright-page": "1" } });
      if (answer.status() !== 201) throw new Error(`sign-in as ${role}: ${answer.status()} ${await answer.text()}`);
    }
    const page = await context.newPage(), wrong = [];
    page.setDefaultTimeout(180_000);
    const expected = (text) => expects.some((one) => text.includes(one));
    // Said of a font where the machine takes seconds to draw: how fast it is, is no matter of a check.
    const isSlowness = (text) => /was preloaded using link preload but not used within a few seconds/.test(text);
    page.on("console", (message) => { if (["error", "warning"].includes(message.type()) && !expected(message.text()) && !isSlowness(message.text())) wrong.push(`console: ${message.text()} ${message.location().url}`); });
    page.on("pageerror", (error) => wrong.push(`exception: ${error.message}`));
    await page.addInitScript(() => addEventListener("securitypolicyviolation", (event) => console.error(`policy: ${event.violatedDirective} ${event.blockedURI} ${event.sourceFile}:${event.lineNumber}`)));
    page.wrong = wrong;
    page.shop = shop;
    page.go = async (path) => { await page.goto(shop.address + path, { waitUntil: "load" }); await page.settled(); };
    // Settled: data are there, nothing is loading, and the last frame is painted.
    page.settled = async () => { await page.waitForFunction(() => !document.querySelector(".skeleton") && document.querySelector("#main")?.children.length > 0 && (document.body.dataset.page === "sign-in" || !document.querySelector("#who") || document.querySelector("#who").textContent)); await page.evaluate(() => document.fonts.ready.then(() => new Promise((wake) => requestAnimationFrame(() => requestAnimationFrame(wake))))); };
    page.finish = async () => { await context.close(); };
    return page;
  }
  close() { return this.chromium.close(); }
}

/** Violations of WCAG 2.1 A and AA as axe-core finds them, in words. The policy forbids injected scripts: CDP is no script. */
export async function violations(page) {
  const client = await page.context().newCDPSession(page);
  await client.send("Runtime.evaluate", { expression: `${axe}; 0` });
  const { result, exceptionDetails } = await client.send("Runtime.evaluate", { awaitPromise: true, returnByValue: true, expression: `axe.run(document, { resultTypes: ["violations"], runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"] }).then((found) => found.violations.map((one) => one.id + ": " + one.help + " (" + one.nodes.slice(0, 3).map((node) => node.target.join(" ") + " " + (node.any[0]?.message ?? "")).join("; ") + ")"))` });
  await client.detach();
  if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
  return result.value;
}
/** Bytes of the heap after a collection. */
export async function heap(page) {
  const client = await page.context().newCDPSession(page);
  await client.send("HeapProfiler.collectGarbage");
  const { usedSize } = await client.send("Runtime.getHeapUsage");
  await client.detach();
  return usedSize;
}
/** Processor time that the page's own thread spends on some work, ms: what else runs on this machine does not count. */
export async function processor(page, work) {
  const client = await page.context().newCDPSession(page);
  await client.send("Performance.enable", { timeDomain: "threadTicks" });
  const spent = async () => (await client.send("Performance.getMetrics")).metrics.find((one) => one.name === "TaskDuration").value * 1000;
  const before = await spent();
  await work();
  const after = await spent();
  await client.detach();
  return after - before;
}
