// The page of a run that goes on: shows frames as they come, and passes on what a person does.

import { bodies, driven, drives, placed, topicOf, under } from "./acts.mjs";
import { held } from "./codec.mjs";
import { words } from "./clock.mjs";
import { drawGhost } from "./draw.mjs";
import { emptyScene, takeFrame, takeStays } from "./feed.mjs";
import { plotsOf } from "./plots.mjs";
import { showCamera, showReadout, showVerdict } from "./readout.mjs";
import { stageOf } from "./stage.mjs";
import { themeOf } from "./theme.mjs";

const DRIVE_MS = 100;
const PLOTS_MS = 500;
const MOST_TEXTS = 100;
const SPEEDS = ["0", "0.1", "0.25", "0.5", "1", "2", "5", "10", "20", "50", "100"];

const find = (selector) => document.querySelector(selector);
const scene = emptyScene();
const shown = new Set();
const keys = new Set();
const DARK = matchMedia("(prefers-color-scheme: dark)");
let [t, follows, ended] = [0, true, false];
let [acts, mayAct, state] = [[], false, { paused: false, rate: 1, ticks: 0 }];
let theme = themeOf(document.documentElement);
let [plots, plotted, told] = [null, 0, 0];
let ghost = null; // what is dragged, and where it is

const grip = {
  take(x, y, reach) {
    const found = follows && !ended ? under(scene, t, x, y, reach, acts) : null;
    if (!found) return false;
    ghost = { track: found.track, x: found.at.x, y: found.at.y, h: found.at.h };
    show();
    return true;
  },
  move(x, y) {
    [ghost.x, ghost.y] = [x, y];
    show();
  },
  turn(steps) {
    ghost.h += (steps * Math.PI) / 12;
    show();
  },
  drop(there) {
    const { track, x, y, h } = ghost;
    ghost = null;
    if (there) ask(placed(scene, track, x, y, h), `${track.role === "truth" ? "robot" : track.name} to ${at(x, y)}`);
    show();
  },
};
const stage = stageOf(find("#world-0"), scene, show, grip);

function at(x, y) {
  return `(${x.toFixed(2)}, ${y.toFixed(2)}) ${scene.unit}`;
}

/** Show the present time everywhere. */
function show() {
  stage.draw(t, theme, shown);
  if (ghost) stage.over((context, view) => drawGhost(context, view, ghost, theme));
  plots?.mark(t);
  const slider = find("#slider");
  slider.max = String(Math.max(scene.moments.length - 1, 0));
  slider.value = String(Math.max(held(scene.moments, t), 0));
  const tick = scene.ticks[held(scene.moments, t)];
  const text = tick === undefined || tick < 0 ? "nothing heard yet" : `${words(t)}, tick ${tick}`;
  slider.setAttribute("aria-valuetext", text);
  find("#time").textContent = text;
  showReadout(find("#readout-0"), scene, t, theme);
  scene.health.forEach(({ spans }, number) => {
    const place = find(`#verdict-0-${number}`);
    if (place) showVerdict(place, spans, t);
  });
  scene.cameras.forEach((camera, number) => {
    const figure = find(`#camera-0-${number}`);
    if (figure) showCamera(figure, camera, t);
  });
}

function takeState(next) {
  state = next;
  const word = ended ? ended : state.paused ? "paused" : "live";
  find("#state").textContent = word;
  find("#state").className = word === "live" ? "state" : "state waits";
  find("#pause").textContent = state.paused ? "Go on" : "Pause";
  const speed = find("#speed");
  const value = String(state.rate);
  if (!SPEEDS.includes(value) && !speed.querySelector(`[value="${value}"]`)) speed.add(new Option(`${value} ×`, value));
  if (document.activeElement !== speed) speed.value = value;
}

function onFrame(data) {
  const changed = takeFrame(scene, data);
  takeState(data.state);
  if (follows) t = data.t;
  if (changed) arrange();
  const now = performance.now();
  if (now - plotted > PLOTS_MS) {
    plotted = now;
    plots?.update();
  }
  show();
}

/** Make room for plots, cameras and verdicts that were not there before. */
function arrange() {
  const verdicts = scene.health.map(({ node }, number) => {
    const line = document.createElement("p");
    line.className = "now-verdict";
    const word = document.createElement("b");
    word.id = `verdict-0-${number}`;
    line.append(`${node} says: `, word);
    return line;
  });
  find("#verdicts").replaceChildren(...verdicts);
  find("#cameras").replaceChildren(...scene.cameras.map(cameraFigure));
  plots?.remove();
  plots = plotsOf(find("#plots"), [{ plots: scene.plots }], theme, (time) => seek(time));
  const select = find("#body-number");
  const count = bodies(scene).length;
  if (select && select.length !== count) {
    select.replaceChildren(...Array.from({ length: count }, (_, index) => new Option(String(index + 1), String(index))));
  }
}

function cameraFigure(camera, number) {
  const make = (name, set) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(set)) element.setAttribute(key, String(value));
    return element;
  };
  const figure = document.createElement("figure");
  figure.className = "camera";
  figure.id = `camera-0-${number}`;
  const svg = make("svg", { viewBox: `0 0 ${camera.w} ${camera.h}`, role: "img", "aria-label": "frame" });
  svg.append(make("image", { width: camera.w, height: camera.h }), make("g", {}));
  const caption = document.createElement("figcaption");
  const name = document.createElement("b");
  name.textContent = camera.topic;
  const when = document.createElement("span");
  when.className = "when";
  caption.append(name, ", ", when);
  figure.append(svg, caption);
  return figure;
}

function onSaid({ n, level, t: time, text }) {
  if (n <= told) return;
  told = n;
  const line = document.createElement("li");
  line.className = level;
  line.textContent = `${words(time)}: ${text}`;
  find("#said").prepend(line);
  while (find("#said").children.length > MOST_TEXTS) find("#said").lastChild.remove();
}

function onBegin(begin) {
  [acts, mayAct] = [begin.acts, begin.mayAct];
  for (const part of document.querySelectorAll("[data-act]")) {
    part.hidden = !part.dataset.act.split(" ").some((act) => acts.some((topic) => topic.endsWith(`operator/${act}`)));
  }
  find("#world-0").classList.toggle("moves", acts.length > 0);
  for (const control of document.querySelectorAll("[data-paces]")) control.disabled = !mayAct;
}

function onEnd({ complete, reason, page }) {
  ended = complete ? "ended" : "ended, incomplete";
  takeState({ ...state, paused: false });
  find("#over").hidden = false;
  find("#reason").textContent = `The run has ended: ${reason || "complete"}.`;
  find("#page-link").hidden = page !== "there";
  find("#page-waits").hidden = page !== "waits";
  for (const control of document.querySelectorAll("[data-paces], #hand button, #hand input, #hand select")) {
    control.disabled = true;
  }
}

/** Ask for something, and say what became of it. */
async function ask(wish, what) {
  const status = find("#status");
  try {
    const headers = { "Content-Type": "application/json" };
    const answer = await fetch("act", { method: "POST", headers, body: JSON.stringify(wish) });
    if (answer.ok) status.textContent = what ? `asked: ${what}` : status.textContent;
    else status.textContent = `refused: ${(await answer.json()).error}`;
  } catch {
    status.textContent = "nothing was asked: the page's server is gone";
  }
}

function pace(change, what) {
  if (mayAct && !ended) ask({ pace: { paused: state.paused, rate: state.rate, steps: 0, ...change } }, what);
}

function seek(time) {
  const last = scene.moments.at(-1) ?? 0;
  t = Math.min(Math.max(time, scene.moments[0] ?? 0), last);
  follows = t >= last;
  find("#now").hidden = follows;
  show();
}

function look(count) {
  const index = Math.min(Math.max(held(scene.moments, t) + count, 0), scene.moments.length - 1);
  seek(scene.moments[index] ?? 0);
}

function toNow() {
  seek(Infinity);
}

function nextSpeed(steps) {
  const index = Math.max(SPEEDS.indexOf(String(state.rate)), 0) + steps;
  const rate = Number(SPEEDS[Math.min(Math.max(index, 1), SPEEDS.length - 1)]);
  pace({ rate }, `${rate} ×`);
}

const KEYS = {
  " ": () => pace({ paused: !state.paused }, state.paused ? "go on" : "pause"),
  ".": () => pace({ paused: true, steps: 1 }, "one step"),
  ArrowLeft: (event) => look(event.shiftKey ? -10 : -1),
  ArrowRight: (event) => look(event.shiftKey ? 10 : 1),
  Home: () => seek(0),
  End: () => toNow(),
  "+": () => nextSpeed(1),
  "-": () => nextSpeed(-1),
  0: () => stage.fit(),
};

function onKey(event) {
  const own = event.target.closest("select, summary, a, button, input:not([type=range], [type=checkbox])");
  if (event.ctrlKey || event.metaKey || event.altKey || own) return;
  if (find("#drives").checked && drives(event.key)) {
    event.preventDefault();
    keys.add(event.key);
    return;
  }
  const action = KEYS[event.key];
  if (!action || (event.key === " " && event.target.matches("input[type=checkbox]"))) return;
  event.preventDefault();
  action(event);
}

/** Drive the first robot that may be driven, by the keys that are held down. */
function drive() {
  if (ended || !find("#drives").checked || keys.size === 0) return;
  const truth = scene.tracks.find((track) => track.role === "truth");
  const moves = topicOf(truth?.robot, "move");
  const anyDirection = acts.includes(moves);
  const [speed, turn] = ["#drive-speed", "#drive-turn"].map((name) => Number(find(name).value));
  const act = driven(keys, speed, turn, anyDirection, state.rate);
  if (act) ask({ topic: anyDirection ? moves : topicOf(truth?.robot, "drive"), act }, "");
}

function connectHand() {
  const number = (name) => Number(find(name).value);
  find("#place").addEventListener("submit", (event) => {
    event.preventDefault();
    const truth = scene.tracks.find((track) => track.role === "truth");
    const [x, y, h] = [number("#place-x"), number("#place-y"), (number("#place-h") * Math.PI) / 180];
    if (truth) ask(placed(scene, truth, x, y, h), `robot to ${at(x, y)}`);
  });
  find("#body").addEventListener("submit", (event) => {
    event.preventDefault();
    const track = bodies(scene)[number("#body-number")];
    if (track) ask(placed(scene, track, number("#body-x"), number("#body-y"), 0), `${track.name} moved`);
  });
  find("#map").addEventListener("submit", (event) => {
    event.preventDefault();
    const robot = scene.tracks.find((track) => track.role === "truth")?.robot;
    ask({ topic: topicOf(robot, "map"), act: { map: find("#map-name").value } }, "another map");
  });
  for (const button of document.querySelectorAll("#door button")) {
    button.addEventListener("click", (event) => {
      event.preventDefault();
      const door = number("#door-number") - 1;
      const robot = scene.tracks.find((track) => track.role === "truth")?.robot;
      ask({ topic: topicOf(robot, "door"), act: { door, to: button.value } }, `door ${door + 1}: ${button.textContent}`);
    });
  }
}

function connect() {
  find("#slider").addEventListener("input", (event) => seek(scene.moments[Number(event.target.value)] ?? 0));
  find("#now").addEventListener("click", toNow);
  find("#pause").addEventListener("click", KEYS[" "]);
  find("#step").addEventListener("click", KEYS["."]);
  find("#speed").addEventListener("change", (event) => pace({ rate: Number(event.target.value) }, "another speed"));
  for (const box of document.querySelectorAll("[data-shows]")) {
    const take = () => (box.checked ? shown.add(box.dataset.shows) : shown.delete(box.dataset.shows));
    take();
    box.addEventListener("change", () => {
      take();
      show();
    });
  }
  for (const [name, steps] of [["#closer", 1], ["#farther", -1]]) find(name).addEventListener("click", () => stage.zoom(steps));
  find("#fit").addEventListener("click", () => stage.fit());
  find("#theme").addEventListener("click", () => setTheme(theme.name === "dark" ? "light" : "dark"));
  document.addEventListener("keydown", onKey);
  document.addEventListener("keyup", (event) => keys.delete(event.key));
  addEventListener("blur", () => keys.clear());
  setInterval(drive, DRIVE_MS);
  addEventListener("resize", () => {
    stage.resize();
    plots?.resize();
    show();
  });
  DARK.addEventListener("change", () => setTheme(DARK.matches ? "dark" : "light"));
  connectHand();
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  theme = themeOf(document.documentElement);
  stage.resize();
  arrange();
  show();
}

/** Listen to what the server tells; a browser connects again by itself. */
function listen() {
  const source = new EventSource("events");
  const takes = { begin: onBegin, frame: onFrame, said: onSaid, end: onEnd };
  for (const [name, take] of Object.entries(takes)) {
    source.addEventListener(name, (event) => take(JSON.parse(event.data)));
  }
  source.addEventListener("stays", (event) => {
    if (takeStays(scene, JSON.parse(event.data))) stage.resize();
  });
  source.addEventListener("error", () => {
    if (!ended) find("#state").textContent = "the page's server does not answer";
  });
}

connect();
setTheme(DARK.matches ? "dark" : "light");
listen();
