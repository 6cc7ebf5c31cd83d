// Acts on a run that goes on, by its live page in Chromium, and prints as JSON what it saw: node live.mjs CHROMIUM ADDRESS
//
// Drags the robot, waits until the page shows it there, pauses, steps, drives by keys, and lets the run end.

import { readFileSync } from "node:fs";
import { chromium } from "playwright-core";
import { FLAGS } from "./flags.mjs";

const [, , executablePath, address] = process.argv;
const axe = readFileSync(new URL("./node_modules/axe-core/axe.min.js", import.meta.url), "utf-8");

/** Return the pose of a track by the page's table, [x, y]; NaN where it has none. */
function told(role) {
  const row = [...document.querySelectorAll("#readout-0 tr")].find((each) => each.dataset.role === role);
  return [1, 2].map((at) => Number(row?.cells[at].textContent ?? NaN));
}

/** Return whether a track is within reach of a point. */
function isNear([role, x, y, reach]) {
  const row = [...document.querySelectorAll("#readout-0 tr")].find((each) => each.dataset.role === role);
  return row !== undefined && Math.hypot(Number(row.cells[1].textContent) - x, Number(row.cells[2].textContent) - y) < reach;
}

/** Return whether a line under "What happens" has a text. */
function isSaid(text) {
  return [...document.querySelectorAll("#said li")].some((line) => line.textContent.includes(text));
}

/** Return whether the page shows a later tick. */
function isBeyond(tick) {
  return Number(document.querySelector("#time").textContent.split("tick ")[1]) > tick;
}

async function tick(page) {
  return Number((await page.textContent("#time")).split("tick ")[1]);
}

/** Return where a point of the map is in the window; the canvas shows what stays from frame to frame, fitted. */
async function pixel(page, bounds, x, y) {
  const box = await page.locator("#world-0").boundingBox();
  const [left, bottom, right, top] = bounds;
  const scale = Math.min(box.width / (right - left), box.height / (top - bottom));
  const u = box.x + box.width / 2 + scale * (x - (left + right) / 2);
  return [u, box.y + box.height / 2 - scale * (y - (bottom + top) / 2)];
}

async function drag(page, bounds, to) {
  await page.locator("#world-0").scrollIntoViewIfNeeded();
  await page.mouse.move(...(await pixel(page, bounds, ...(await page.evaluate(told, "truth")))));
  await page.mouse.down();
  await page.mouse.move(...(await pixel(page, bounds, ...to)), { steps: 4 });
  await page.mouse.up();
}

async function faults(page) {
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return found.violations
    .filter(({ impact }) => ["serious", "critical"].includes(impact))
    .map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map((node) => node.html).join(" ")}`);
}

async function look(browser, width, colorScheme) {
  const context = await browser.newContext({ viewport: { width, height: 900 }, colorScheme });
  const page = await context.newPage();
  await page.goto(address);
  await page.waitForFunction(isNear, ["truth", 0, 0, 100]);
  await page.waitForSelector(".plot canvas");
  const found = {
    overflow: (await page.evaluate(() => document.documentElement.scrollWidth)) - width,
    faults: await faults(page),
  };
  await context.close();
  return found;
}

const browser = await chromium.launch({ executablePath, args: FLAGS });
const page = await (await browser.newContext({ viewport: { width: 1400, height: 1000 } })).newPage();
const said = [];
page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
page.on("pageerror", (error) => said.push(`error: ${error.message}`));
page.on("request", (request) => {
  if (!request.url().startsWith(address) && !request.url().startsWith("data:")) said.push(`request: ${request.url()}`);
});
const bounds = [-3.3, -2.3, 3.3, 2.3];
await page.goto(address);
await page.waitForFunction(isNear, ["truth", 0, 0, 100]);
const found = { said, wide: await look(browser, 1400, "light"), narrow: await look(browser, 400, "dark") };
await drag(page, bounds, [1.5, -1.0]);
await page.waitForFunction(isNear, ["truth", 1.5, -1.0, 0.3], { polling: 20 });
await page.waitForFunction(isNear, ["estimate", 1.5, -1.0, 1.0], { polling: 20 });
found.recovered = await tick(page);
await page.locator("#pause").click();
await page.waitForFunction(() => document.querySelector("#state").textContent === "paused");
await page.waitForFunction(isSaid, "has paused");
const before = await tick(page);
await page.keyboard.press("."); // whose focus is on the button: nothing is to come of it
await page.locator("#step").click();
await page.waitForFunction(isBeyond, before);
found.stepped = (await tick(page)) - before;
await page.locator("#pause").click();
await page.waitForFunction(isBeyond, before + 5);
await page.locator("#drives").check();
await page.keyboard.down("ArrowUp");
await page.waitForFunction(isSaid, "operator/drive");
await page.keyboard.up("ArrowUp");
await page.locator("#place-x").fill("90");
await page.locator("#place button").click();
await page.waitForFunction(isSaid, "does not fit");
await page.locator("#speed").selectOption("0");
await page.waitForSelector("#page-link:not([hidden])", { timeout: 120000 });
found.over = await page.textContent("#reason");
await page.locator("#page-link a").click();
await page.waitForFunction(() => document.querySelector("#slider")?.max > 100);
found.finished = await page.textContent("h1");
await browser.close();
console.log(JSON.stringify(found));
