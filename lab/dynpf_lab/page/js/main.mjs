// Puts a page together: the clock, its controls, the worlds, the plots and the words of what holds now.

import { held } from "./codec.mjs";
import { advanced, merged, nextSpeed, usualSpeed, words } from "./clock.mjs";
import { plotsOf } from "./plots.mjs";
import { showCamera, showReadout, showVerdict } from "./readout.mjs";
import { stageOf } from "./stage.mjs";
import { themeOf } from "./theme.mjs";
import { world } from "./world.mjs";

const find = (selector, root = document) => root.querySelector(selector);
const page = JSON.parse(find("#data").textContent);
const scenes = page.runs.map(world);
const end = Math.max(...page.runs.map((run) => run.seconds));
const moments = merged(scenes.map((scene) => scene.moments));
const slider = find("#slider");
const DARK = matchMedia("(prefers-color-scheme: dark)");
const shown = new Set();
let [t, playing, before, speed] = [0, false, 0, usualSpeed(end)];
let theme = themeOf(document.documentElement);
let plots = null;

const stages = scenes.map((scene, index) => stageOf(find(`#world-${index}`), scene, show));

/** Show the present time everywhere. */
function show() {
  stages.forEach((stage) => stage.draw(t, theme, shown));
  plots?.mark(t);
  slider.value = String(Math.max(held(moments, t), 0));
  const tick = tickAt(scenes[0]);
  const text = tick === null ? words(t) : `${words(t)}, tick ${tick}`;
  slider.setAttribute("aria-valuetext", text);
  find("#time").textContent = text;
  scenes.forEach((scene, index) => {
    showReadout(find(`#readout-${index}`), scene, t, theme);
    scene.health.forEach(({ spans }, number) => showVerdict(find(`#verdict-${index}-${number}`), spans, t));
    scene.cameras.forEach((camera, number) => showCamera(find(`#camera-${index}-${number}`), camera, t));
  });
}

function tickAt(scene) {
  const tick = scene.ticks[held(scene.moments, t)];
  return tick === undefined || Number.isNaN(tick) ? null : tick;
}

function seek(time) {
  t = Math.min(Math.max(time, 0), end);
  show();
}

/** Go so many moments on, or back. */
function move(count) {
  const index = Math.min(Math.max(held(moments, t) + count, 0), moments.length - 1);
  seek(moments[index]);
}

function play(wanted) {
  playing = wanted;
  if (playing && t >= end - 1e-9) t = 0;
  find("#play").textContent = playing ? "Pause" : "Play";
  if (playing) {
    before = performance.now();
    requestAnimationFrame(frame);
  }
}

function frame(now) {
  if (!playing) return;
  const next = advanced(t, (now - before) / 1000, speed, end);
  before = now;
  t = next.t;
  show();
  if (next.playing) requestAnimationFrame(frame);
  else play(false);
}

function setSpeed(value) {
  speed = value;
  find("#speed").value = String(value);
}

const KEYS = {
  " ": () => play(!playing),
  ArrowLeft: (event) => move(event.shiftKey ? -10 : -1),
  ArrowRight: (event) => move(event.shiftKey ? 10 : 1),
  Home: () => seek(0),
  End: () => seek(end),
  "+": () => setSpeed(nextSpeed(speed, 1)),
  "-": () => setSpeed(nextSpeed(speed, -1)),
  0: () => stages.forEach((stage) => stage.fit()),
};

function onKey(event) {
  const own = event.target.closest("button, select, summary, a, input:not(#slider)");
  const action = KEYS[event.key];
  if (!action || own || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action(event);
}

/** Put the marks of events, verdicts and the first difference where the slider has their times. */
function placeMarks() {
  for (const mark of document.querySelectorAll("[data-from]")) {
    const [from, to] = [Number(mark.dataset.from), Number(mark.dataset.to ?? mark.dataset.from)];
    mark.style.left = `${(100 * from) / (end || 1)}%`;
    if (mark.dataset.to !== undefined) mark.style.width = `${(100 * (to - from)) / (end || 1)}%`;
  }
  for (const button of document.querySelectorAll("[data-seek]")) {
    button.addEventListener("click", () => seek(Number(button.dataset.seek)));
  }
}

function build() {
  theme = themeOf(document.documentElement);
  plots?.remove();
  plots = plotsOf(find("#plots"), page.runs, theme, seek);
  stages.forEach((stage) => stage.resize());
  show();
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  build();
}

function connect() {
  slider.max = String(moments.length - 1);
  slider.addEventListener("input", () => seek(moments[Number(slider.value)]));
  find("#play").addEventListener("click", () => play(!playing));
  find("#speed").addEventListener("change", (event) => setSpeed(Number(event.target.value)));
  for (const box of document.querySelectorAll("[data-shows]")) {
    const take = () => (box.checked ? shown.add(box.dataset.shows) : shown.delete(box.dataset.shows));
    take();
    box.addEventListener("change", () => {
      take();
      show();
    });
  }
  for (const [name, steps] of [["#closer", 1], ["#farther", -1]]) {
    find(name).addEventListener("click", () => stages.forEach((stage) => stage.zoom(steps)));
  }
  find("#fit").addEventListener("click", () => stages.forEach((stage) => stage.fit()));
  find("#theme").addEventListener("click", () => setTheme(theme.name === "dark" ? "light" : "dark"));
  for (const button of document.querySelectorAll(".copy")) button.addEventListener("click", copy);
  document.addEventListener("keydown", onKey);
  addEventListener("resize", () => {
    stages.forEach((stage) => stage.resize());
    plots.resize();
    show();
  });
  DARK.addEventListener("change", () => setTheme(DARK.matches ? "dark" : "light"));
  let kept = "light";
  addEventListener("beforeprint", () => {
    kept = document.documentElement.dataset.theme;
    setTheme("light");
  });
  addEventListener("afterprint", () => setTheme(kept));
}

async function copy(event) {
  const place = event.target.parentElement;
  const [command, status] = [find("code", place), find("[role=status]", place)];
  try {
    await navigator.clipboard.writeText(command.textContent);
    status.textContent = "copied";
  } catch {
    getSelection().selectAllChildren(command);
    status.textContent = "selected: copy it by keyboard";
  }
}

setSpeed(speed);
connect();
placeMarks();
setTheme(DARK.matches ? "dark" : "light");
// The middle of the run tells more than its first moment.
seek(moments[Math.floor(0.6 * (moments.length - 1))] ?? 0);
