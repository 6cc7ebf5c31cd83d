// Opens pages in Chromium, without a network, and prints as JSON what it finds: node pages.mjs CHROMIUM SHOTS PAGE...
//
// Of pages whose names begin with `shown-` the folder SHOTS gets pictures: wide and narrow, light and dark.
//
// For each page: what the console says, the poses that it tells at 20 moments of the slider, how much is drawn, serious
// faults that axe finds, whether it fits the window's width, and the time after a step by key and after playing.

import { readFileSync } from "node:fs";
import { basename, join } from "node:path";
import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";
import { FLAGS } from "./flags.mjs";

const MOMENTS = 20;
const [, , executablePath, shots, ...files] = process.argv;
const axe = readFileSync(new URL("./node_modules/axe-core/axe.min.js", import.meta.url), "utf-8");

/** Return the moments at which the slider was put, each with its tick and what the table of poses then says. */
async function poses(page) {
  return page.evaluate((count) => {
    const slider = document.querySelector("#slider");
    const last = Number(slider.max);
    return Array.from({ length: count }, (_, number) => {
      slider.value = String(Math.round((number * last) / (count - 1)));
      slider.dispatchEvent(new Event("input"));
      const rows = [...document.querySelectorAll("#readout-0 tr")].map((row) => ({
        role: row.dataset.role,
        cells: [...row.cells].map((cell) => cell.textContent),
      }));
      return { time: document.querySelector("#time").textContent, rows };
    });
  }, MOMENTS);
}

/** Return how many pixels of the world are drawn on. */
async function inked(page) {
  return page.evaluate(() => {
    const canvas = document.querySelector("#world-0");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.filter((value, index) => index % 4 === 3 && value > 0).length;
  });
}

async function faults(page) {
  // The page's own policy forbids foreign scripts; a context of Chromium's that bypasses it is for this test alone.
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return found.violations
    .filter(({ impact }) => ["serious", "critical"].includes(impact))
    .map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map((node) => node.html).join(" ")}`);
}

/** Open a page and wait for its first picture. */
async function opened(browser, file, width, colorScheme, listen) {
  const context = await browser.newContext({ viewport: { width, height: 900 }, colorScheme, offline: true });
  const page = await context.newPage();
  listen?.(page);
  await page.goto(pathToFileURL(file).href);
  await page.waitForFunction(() => document.querySelector("#time").textContent !== "");
  return { context, page };
}

/** Take a picture of a page at the middle of its run. */
async function shoot(browser, file, width, colorScheme) {
  const { context, page } = await opened(browser, file, width, colorScheme);
  await page.evaluate(() => {
    const slider = document.querySelector("#slider");
    slider.value = String(Math.round(Number(slider.max) / 2));
    slider.dispatchEvent(new Event("input"));
  });
  const name = basename(file, ".html").replace("shown-", "");
  await page.screenshot({ path: join(shots, `${name}-${width}-${colorScheme}.png`), animations: "disabled" });
  await context.close();
}

async function look(browser, file, width, colorScheme, audited) {
  const said = [];
  const { context, page } = await opened(browser, file, width, colorScheme, (fresh) => {
    fresh.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
    fresh.on("pageerror", (error) => said.push(`error: ${error.message}`));
    fresh.on("request", (request) => {
      if (!/^(file|data):/.test(request.url())) said.push(`request: ${request.url()}`);
    });
  });
  const found = {
    said,
    poses: await poses(page),
    inked: await inked(page),
    overflow: (await page.evaluate(() => document.documentElement.scrollWidth)) - width,
    faults: audited ? await faults(page) : [],
  };
  await page.locator("body").press("Home");
  await page.locator("body").press("ArrowRight");
  found.second = await page.textContent("#time");
  await page.locator("body").press("Space");
  await page.waitForFunction((before) => document.querySelector("#time").textContent !== before, found.second);
  found.played = await page.textContent("#time");
  await context.close();
  return found;
}

const browser = await chromium.launch({ executablePath, args: FLAGS });
const found = {};
const left = [...files];

async function work() {
  for (let file = left.shift(); file !== undefined; file = left.shift()) {
    const shown = basename(file).startsWith("shown-");
    const wide = await look(browser, file, 1400, "light", true);
    found[file] = { wide, narrow: await look(browser, file, 400, "dark", shown) };
    if (!shown) continue;
    for (const width of [1400, 400]) for (const scheme of ["light", "dark"]) await shoot(browser, file, width, scheme);
  }
}

await Promise.all([work(), work()]); // two at once
await browser.close();
console.log(JSON.stringify(found));
