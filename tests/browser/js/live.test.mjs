// The pure parts of a live page's script, by node's own test runner.

import assert from "node:assert/strict";
import { test } from "node:test";

import { driven, placed, under } from "../../../lab/dynpf_lab/page/js/acts.mjs";
import { emptyScene, halved, takeFrame, takeStays } from "../../../lab/dynpf_lab/page/js/feed.mjs";

const list = (values) => values;
const truth = (t, x) => ({ name: "truth", role: "truth", robot: "", radius: 0.2, t: list(t), x: list(x), y: t.map(() => 0), h: t.map(() => 0) });
const frame = (t, tracks, more = {}) => ({
  t, tick: Math.round(10 * t), tracks, clouds: [], readings: [], layers: [], plots: [], health: [], cameras: [], ...more,
});

test("a track grows by what is new, whatever frames were left out or came twice", () => {
  const scene = emptyScene();
  takeFrame(scene, frame(0.2, [truth([0, 0.1, 0.2], [0, 1, 2])]));
  takeFrame(scene, frame(0.2, [truth([0, 0.1, 0.2], [0, 1, 2])]));
  takeFrame(scene, frame(0.9, [truth([0.2, 0.8, 0.9], [2, 8, 9])]));
  assert.deepEqual(scene.tracks[0].x, [0, 1, 2, 8, 9]);
  assert.deepEqual([scene.moments, scene.ticks], [[0.2, 0.9], [2, 9]]);
});

test("a run of any length keeps a bounded world", () => {
  const scene = emptyScene();
  const plot = (t) => ({ key: "e", title: "Error", unit: "m", about: "", signed: false, lines: [{ label: "error", kind: "line", hidden: false, t: [t], v: [t] }] });
  for (let at = 0; at < 20000; at += 1) {
    takeFrame(scene, frame(at / 10, [truth([at / 10], [at])], { plots: [plot(at / 10)] }));
  }
  assert.ok(scene.tracks[0].t.length <= 6000);
  assert.ok(scene.plots[0].lines[0].t.length <= 3000);
  assert.equal(scene.tracks[0].t.at(-1), 1999.9);
  assert.equal(scene.plots[0].lines[0].v.at(-1), 1999.9);
  assert.deepEqual(halved([1, 2, 3, 4, 5]), [1, 3, 5]);
});

test("lines grow in place, for plots hold on to them; bounds go from the first time to the last", () => {
  const scene = emptyScene();
  const plot = (t) => ({ key: "n", title: "NEES", unit: "", about: "", signed: false, lines: [{ label: "low", kind: "bound", hidden: false, t: [t, t + 1], v: [5, 5] }] });
  takeFrame(scene, frame(1, [], { plots: [plot(0)] }));
  const { t, v } = scene.plots[0].lines[0];
  takeFrame(scene, frame(2, [], { plots: [plot(7)] }));
  assert.deepEqual([t, v], [[0, 8], [5, 5]]);
});

test("a verdict lasts until the next, however many frames say it", () => {
  const scene = emptyScene();
  const says = (begin, end, status) => [{ node: "estimator", spans: [[begin, end, status, "", ""]] }];
  for (const [begin, end, status] of [[0, 1, "tracking"], [0.9, 2, "tracking"], [1.9, 3, "kidnapped"], [2.9, 4, "kidnapped"]]) {
    takeFrame(scene, frame(end, [], { health: says(begin, end, status) }));
  }
  assert.deepEqual(scene.health[0].spans.map((span) => span.slice(0, 3)), [[0, 2, "tracking"], [1.9, 4, "kidnapped"]]);
});

test("the view is fitted anew only when the world has other bounds", () => {
  const scene = emptyScene();
  const stays = { unit: "m", bounds: [-3, -2, 3, 2], grids: [], shapes: [] };
  assert.equal(takeStays(scene, stays), true);
  assert.equal(takeStays(scene, { ...stays }), false);
});

test("the nearest thing that may be moved is dragged, and put where it is dropped", () => {
  const scene = emptyScene();
  const part = { ...truth([0], [1]), name: "part 1", role: "body", radius: 0.1 };
  const guess = { ...part, name: "estimate", radius: 0 };
  takeFrame(scene, frame(0, [truth([0], [0]), guess, part]));
  const acts = ["operator/place", "operator/body"];
  assert.equal(under(scene, 0, 0.1, 0, 0.01, acts).track.role, "truth");
  assert.equal(under(scene, 0, 1.05, 0, 0.01, acts).track.name, "part 1");
  assert.equal(under(scene, 0, 0.5, 0, 0.01, acts), null);
  assert.equal(under(scene, 0, 1.05, 0, 0.01, ["operator/place"]), null);
  const [robot, , body] = scene.tracks;
  assert.deepEqual(placed(scene, robot, 1.23456, -2, 3 * Math.PI), { topic: "operator/place", act: { x: 1.2346, y: -2, theta: 3.1416 } });
  assert.deepEqual(placed(scene, body, 0, 0, 0), { topic: "operator/body", act: { body: 0, x: 0, y: 0 } });
});

test("keys drive a robot ahead and round, or along the map's axes", () => {
  assert.equal(driven(new Set(), 0.3, 1, false, 1), null);
  assert.deepEqual(driven(new Set(["ArrowUp", "a"]), 0.3, 1, false, 1), { v: 0.3, w: 1, lasts_s: 0.4 });
  assert.deepEqual(driven(new Set(["ArrowUp", "ArrowDown"]), 0.3, 1, false, 5), { v: 0, w: 0, lasts_s: 2 });
  const { vx, vy, w } = driven(new Set(["ArrowRight", "w", "e"]), 1, 2, true, 1);
  assert.ok(Math.abs(Math.hypot(vx, vy) - 1) < 1e-12 && vx > 0 && vy > 0);
  assert.equal(w, -2);
});
