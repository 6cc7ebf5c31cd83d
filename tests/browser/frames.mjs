// Measures a page in Chromium: node frames.mjs CHROMIUM PAGE.html [SECONDS]
//
// Prints the time to its first picture, and how many pictures a second it draws while it plays.

import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";
import { FLAGS } from "./flags.mjs";

const [, , executablePath, file, seconds = "4"] = process.argv;
const browser = await chromium.launch({ executablePath, args: FLAGS });
const context = await browser.newContext({ viewport: { width: 1400, height: 960 }, offline: true });
const page = await context.newPage();
await page.addInitScript(() => {
  const began = performance.now();
  const watch = () => {
    if (document.querySelector("#time")?.textContent) globalThis.firstPicture = performance.now() - began;
    else requestAnimationFrame(watch);
  };
  requestAnimationFrame(watch);
});
await page.goto(pathToFileURL(file).href);
await page.waitForFunction(() => globalThis.firstPicture !== undefined);
const first = await page.evaluate(() => globalThis.firstPicture);
await page.locator("body").press("Space");
const played = await page.evaluate(
  (lasts) =>
    new Promise((resolve) => {
      const began = performance.now();
      let frames = 0;
      const count = (now) => {
        frames += 1;
        if (now - began < 1000 * lasts) requestAnimationFrame(count);
        else resolve(frames / ((now - began) / 1000));
      };
      requestAnimationFrame(count);
    }),
  Number(seconds),
);
console.log(`first picture after ${first.toFixed(0)} ms, ${played.toFixed(1)} pictures a second`);
await browser.close();
