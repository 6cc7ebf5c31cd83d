// Takes a picture of the beginning of a page: node picture.mjs CHROMIUM PAGE.html PICTURE.png

import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";
import { FLAGS } from "./flags.mjs";

const [, , executablePath, file, path] = process.argv;
const browser = await chromium.launch({ executablePath, args: FLAGS });
const context = await browser.newContext({ viewport: { width: 1400, height: 960 }, colorScheme: "light", offline: true });
const page = await context.newPage();
await page.goto(pathToFileURL(file).href);
await page.waitForFunction(() => document.querySelector("#time").textContent !== "");
await page.screenshot({ path });
await browser.close();
