// The pure parts of a page's script, by node's own test runner.

import assert from "node:assert/strict";
import { test } from "node:test";

import { advanced, merged, nextSpeed, usualSpeed, words } from "../../../lab/dynpf_lab/page/js/clock.mjs";
import { cells, column, held, points } from "../../../lab/dynpf_lab/page/js/codec.mjs";
import { ellipse, fit, panned, roundLength, toMap, toScreen, zoomed } from "../../../lab/dynpf_lab/page/js/geometry.mjs";
import { aligned, gathered, range, told } from "../../../lab/dynpf_lab/page/js/series.mjs";
import { pose, verdict } from "../../../lab/dynpf_lab/page/js/world.mjs";

const near = (a, b, off = 1e-9) => assert.ok(Math.abs(a - b) <= off, `${a} is not ${b}`);

test("a column is the sum of its differences, and NaN where nothing is told", () => {
  assert.deepEqual([...column({ q: 0.5, d: [4, null, -2, 0] })], [2, NaN, 1, 1]);
});

test("points are offsets from the middle of their set", () => {
  const bytes = new Uint8Array(new Int16Array([100, -100, 1, 2]).buffer);
  const packed = { q: 0.01, x: { q: 1, d: [3, 1] }, y: { q: 1, d: [0, 7] }, n: [1, 1], b: btoa(String.fromCharCode(...bytes)) };
  assert.deepEqual(points(packed).map((set) => [...set]), [[4, -1], [4.01, 7.02]]);
});

test("cells come in runs", () => {
  assert.deepEqual([...cells({ w: 3, h: 2, runs: [4 * 2 + 1, 4 * 3 + 0, 4 * 1 + 2] })], [1, 1, 0, 0, 0, 2]);
});

test("what holds at a time is the last that is not after it", () => {
  const times = [0, 0.1, 0.1, 0.3];
  assert.deepEqual([-0.1, 0, 0.0999, 0.2, 0.3, 9].map((t) => held(times, t)), [-1, 0, 2, 2, 3, 3]);
  assert.equal(held([], 1), -1);
});

test("a view shows all of its bounds, and pixels go back to where they came from", () => {
  const view = fit([-1, 0, 3, 2], 400, 400);
  for (const [x, y] of [[-1, 0], [3, 2]]) {
    const [u, v] = toScreen(view, x, y);
    assert.ok(u >= -1e-9 && u <= 400 + 1e-9 && v >= 0 && v <= 400);
    const back = toMap(view, u, v);
    near(back[0], x);
    near(back[1], y);
  }
});

test("enlarging keeps the point under the pointer, moving keeps the scale", () => {
  const view = fit([0, 0, 10, 10], 300, 200);
  const before = toMap(view, 40, 50);
  const after = toMap(zoomed(view, 2.5, 40, 50), 40, 50);
  near(after[0], before[0]);
  near(after[1], before[1]);
  const [u, v] = toScreen(panned(view, 7, -9), ...before);
  near(u, 47);
  near(v, 41);
});

test("an ellipse has the axes of its covariance", () => {
  const { major, minor, angle } = ellipse(2, 1, 2, 3);
  near(major, 3 * Math.sqrt(3));
  near(minor, 3);
  near(angle, Math.PI / 4);
  assert.equal(ellipse(0, 0, 0, 3).major, 0);
});

test("a scale is 1, 2 or 5 times a power of ten", () => {
  assert.deepEqual([0.7, 1, 4.9, 5, 99].map(roundLength), [0.5, 1, 2, 5, 50]);
});

test("time goes on with the speed, and stops at the end", () => {
  assert.deepEqual(advanced(1, 0.5, 4, 10), { t: 3, playing: true });
  assert.deepEqual(advanced(9.9, 0.5, 4, 10), { t: 10, playing: false });
  assert.equal(usualSpeed(10), 1);
  assert.equal(usualSpeed(1400), 50);
  assert.equal(nextSpeed(0.1, -1), 0.1);
  assert.equal(nextSpeed(1, 1), 2);
});

test("the times of two runs are one list", () => {
  assert.deepEqual([...merged([[0, 1, 2], [0.5, 1, 3]])], [0, 0.5, 1, 2, 3]);
});

test("times are told in words", () => {
  assert.equal(words(5.25), "5.25 s");
  assert.equal(words(125), "2 min 05.0 s");
});

const line = (label, values, kind = "line") => {
  let before = 0;
  const d = values.map((value) => (value === null ? null : value - before + ((before = value), 0)));
  return { label, kind, hidden: false, t: { q: 1, d: values.map((_, at) => (at ? 1 : 0)) }, v: { q: 1, d } };
};
const plot = (...lines) => ({ key: "k", title: "Error", unit: "m", about: "", signed: false, lines });

test("lines of two runs are told apart, bounds are there once", () => {
  const runs = [{ plots: [plot(line("e", [1, 2]), line("b", [5, 5], "bound"))] }, { plots: [plot(line("e", [3]), line("b", [5], "bound"))] }];
  assert.deepEqual(gathered(runs)[0].lines.map((each) => each.label), ["A: e", "A: b", "B: e"]);
});

test("lines share their times; a band has two edges, and a gap is no missing time", () => {
  const longer = line("e", [4, null, 6]);
  const data = aligned(plot(line("3 sigma", [1, 2], "band"), longer));
  assert.deepEqual(data, [[0, 1, 2], [0, 0, undefined], [1, 2, undefined], [4, null, 6]]);
});

test("a wide band does not flatten the line", () => {
  const both = plot(line("3 sigma", [1000, 1000], "band"), line("e", [1, 2]));
  const [low, high] = range(both, aligned(both));
  assert.equal(low, 0);
  assert.ok(high > 2 && high < 10);
});

test("a plot is told in words for those who do not see it", () => {
  assert.equal(told(plot(line("e", [1, 3, 2]))), "Error, m. e: 1 to 3, at last 2.");
});

test("a pose and a verdict hold until the next", () => {
  const track = { t: [1, 2], x: [5, 6], y: [0, 0], h: [0, 0] };
  assert.equal(pose(track, 0.5), null);
  assert.equal(pose(track, 1.9).x, 5);
  assert.equal(pose(track, 2).x, 6);
  assert.equal(verdict([[0, 3, "tracking", ""], [3, 9, "lost", ""]], 3)[2], "lost");
});
