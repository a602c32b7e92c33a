// The pictures of the README, from a simulated shop: docs/screens/*.png.
import { mkdir, stat } from "node:fs/promises";
import { Browser } from "./browser.js";
import { Shop } from "./shop.js";

const PLACE = new URL("../../docs/screens/", import.meta.url).pathname;
/** A picture is kept with the sources: none is larger, bytes. */
const LARGEST = 200_000;
const ONLY = process.argv.slice(2);
const PHONE = { width: 390, height: 844 };
const [shop, browser] = await Promise.all([Shop.open({ machines: 12, cycles: 160, odd: false, faults: "air_cut,thickness" }), Browser.open()]);
await mkdir(PLACE, { recursive: true });
/** A tool whose life says most: many cycles since its last change, and the trend is known. */
const lives = (await shop.ask("GET", "/v1/fleet?limit=100")).body.items.filter((one) => one.wear?.level?.decides).sort((a, b) => Boolean(b.wear.remaining) - Boolean(a.wear.remaining) || b.wear.cycles - a.wear.cycles);
try {
  for (const [name, path, options, drawn] of [
    ["fleet", "/", {}],
    ["fleet-wall", "/?view=wall", { theme: "dark" }],
    ["fleet-phone", "/", PHONE],
    ["cycle", "/cycle?machine=sim-3&compare=new", {}, "#refkey svg"],
    ["cycle-what-if", "/cycle?machine=sim-3&compare=whatif", { theme: "dark" }, "#refkey svg"],
    ["cycle-phone", "/cycle?machine=sim-3", { ...PHONE, theme: "dark", language: "de-DE" }],
    ["tool", `/tool?id=${lives[0].last_cycle.tool}`, {}],
    ["profile", "/profile", {}, "#ribbon .seg-l"],
    ["next", `/next?machine=${lives[0].machine}`, { theme: "dark", language: "de-DE" }],
    ["strategies", "/studies", {}, "#answer table"],
    ["vibratory", "/studies#vibratory", { theme: "dark" }, "#map canvas"],
  ].filter(([name]) => ONLY.length === 0 || ONLY.includes(name))) {
    const page = await browser.page(shop, { role: "engineer", width: 1280, height: 860, ...options });
    page.setDefaultTimeout(300_000);
    await page.go(path);
    if (drawn) { await page.locator(drawn).first().waitFor(); await page.settled(); }
    await page.screenshot({ path: `${PLACE}${name}.png` });
    if (page.wrong.length) throw new Error(page.wrong.join("\n"));
    const { size } = await stat(`${PLACE}${name}.png`);
    if (size > LARGEST) throw new Error(`${name}.png has ${size} bytes`);
    await page.finish();
    console.log(`docs/screens/${name}.png (${Math.round(size / 1024)} KiB)`);
  }
} finally {
  await browser.close();
  await shop.close();
}
