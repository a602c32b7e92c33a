// The pictures of the README, from a simulated shop: docs/screens/*.png.
import { mkdir } from "node:fs/promises";
import { Browser } from "./browser.js";
import { Shop } from "./shop.js";

const PLACE = new URL("../../docs/screens/", import.meta.url).pathname;
const [shop, browser] = await Promise.all([Shop.open({ machines: 12, cycles: 190 }), Browser.open()]);
await mkdir(PLACE, { recursive: true });
try {
  for (const [name, path, options] of [
    ["fleet", "/", {}],
    ["cycle", "/cycle?machine=sim-4&compare=new", {}],
    ["tool", "/tool?id=sim-tool-1", { theme: "dark" }],
  ]) {
    const page = await browser.page(shop, { role: "engineer", width: 1280, height: 800, ...options });
    await page.go(path);
    if (path.includes("compare")) await page.locator("#refkey svg").waitFor();
    await page.screenshot({ path: `${PLACE}${name}.png` });
    if (page.wrong.length) throw new Error(page.wrong.join("\n"));
    await page.finish();
    console.log(`docs/screens/${name}.png`);
  }
} finally {
  await browser.close();
  await shop.close();
}
