// The world of a run that goes on: grows by frames, and forgets what is long ago.

import { column } from "./codec.mjs";
import { world } from "./world.mjs";

const MOST_POSES = 6000; // of a track; beyond that every second of them is forgotten
const MOST_SETS = 300; // clouds of particles, readings, and what changes in the world
const MOST_VALUES = 3000; // of a line
const MOST_SPANS = 400;
const SOON = 5e-4; // s; times are rounded to milliseconds

/** Return a world in which nothing is known yet. */
export function emptyScene() {
  return {
    unit: "m", bounds: [-1, -1, 1, 1], moments: [], ticks: [], grids: [], shapes: [], layers: [], tracks: [], clouds: [],
    readings: [], cameras: [], health: [], plots: [],
  };
}

/** Take what stays from frame to frame; return whether the view has to be fitted anew. */
export function takeStays(scene, data) {
  const read = world({ ...NOTHING, ...data });
  const fits = scene.bounds.every((value, index) => value === read.bounds[index]);
  Object.assign(scene, { unit: read.unit, bounds: read.bounds, grids: read.grids, shapes: read.shapes });
  return !fits;
}

const NOTHING = {
  moments: { t: [], tick: [] }, layers: [], tracks: [], clouds: [], readings: [], cameras: [], health: [],
};

/** Take a frame; return whether there is a plot, a line, a camera or a filter that was not there before. */
export function takeFrame(scene, data) {
  const read = world({ ...NOTHING, ...data, grids: [], shapes: [] });
  const before = count(scene);
  if (scene.moments.length === 0 || data.t > scene.moments.at(-1) + SOON) {
    scene.moments.push(data.t);
    scene.ticks.push(data.tick);
    if (scene.moments.length > MOST_POSES) [scene.moments, scene.ticks] = [halved(scene.moments), halved(scene.ticks)];
  }
  read.tracks.forEach((track) => growTrack(scene.tracks, track));
  read.clouds.forEach((cloud) => growSets(scene.clouds, cloud, (one) => one.node === cloud.node, "points"));
  read.readings.forEach((each) => growSets(scene.readings, each, (one) => one.topic === each.topic, "points"));
  read.layers.forEach((layer, index) => growSets(scene.layers, layer, (_, at) => at === index, "shapes"));
  read.cameras.forEach((camera) => replace(scene.cameras, camera, (one) => one.topic === camera.topic));
  read.health.forEach((each) => growHealth(scene.health, each));
  data.plots.forEach((plot) => growPlot(scene.plots, plot));
  return count(scene) !== before;
}

function count(scene) {
  return [scene.plots.map((plot) => plot.lines.length), scene.cameras.length, scene.health.length].join();
}

function growTrack(tracks, read) {
  const same = (one) => one.name === read.name && one.role === read.role && one.robot === read.robot;
  let track = tracks.find(same);
  if (!track) {
    track = { ...read, t: [], x: [], y: [], h: [], cov: read.cov && { xx: [], xy: [], yy: [] } };
    tracks.push(track);
  }
  track.radius = read.radius;
  read.t.forEach((time, index) => {
    if (track.t.length > 0 && time <= track.t.at(-1) + SOON) return;
    for (const name of ["t", "x", "y", "h"]) track[name].push(read[name][index]);
    if (track.cov) for (const name of ["xx", "xy", "yy"]) track.cov[name].push(read.cov?.[name][index] ?? 0);
  });
  if (track.t.length <= MOST_POSES) return;
  for (const name of ["t", "x", "y", "h"]) track[name] = halved(track[name]);
  if (track.cov) for (const name of ["xx", "xy", "yy"]) track.cov[name] = halved(track.cov[name]);
}

/** Return every second of some values, and the last. */
export function halved(values) {
  return values.filter((_, index) => (values.length - 1 - index) % 2 === 0);
}

function growSets(all, read, same, name) {
  let kept = all.find(same);
  if (!kept) {
    kept = { ...read, t: [], [name]: [] };
    all.push(kept);
  }
  read.t.forEach((time, index) => {
    if (kept.t.length > 0 && time <= kept.t.at(-1) + SOON) return;
    kept.t.push(time);
    kept[name].push(read[name][index]);
  });
  kept.t.splice(0, kept.t.length - MOST_SETS);
  kept[name].splice(0, kept[name].length - MOST_SETS);
}

function replace(all, read, same) {
  const index = all.findIndex(same);
  if (index < 0) all.push(read);
  else all[index] = read;
}

function growHealth(all, { node, spans }) {
  let kept = all.find((one) => one.node === node);
  if (!kept) {
    kept = { node, spans: [] };
    all.push(kept);
  }
  for (const span of spans) {
    const last = kept.spans.at(-1);
    if (last && span[1] <= last[0] + SOON) continue;
    if (last && last[2] === span[2]) last[1] = Math.max(last[1], span[1]);
    else kept.spans.push([...span]);
  }
  kept.spans.splice(0, kept.spans.length - MOST_SPANS);
}

function growPlot(plots, read) {
  let plot = plots.find((one) => one.key === read.key);
  if (!plot) {
    plot = { ...read, lines: [] };
    plots.push(plot);
  }
  for (const line of read.lines) growLine(plot.lines, line);
}

function growLine(lines, read) {
  let line = lines.find((one) => one.label === read.label);
  if (!line) {
    line = { ...read, t: [], v: [] };
    lines.push(line);
  }
  const [times, values] = [column(read.t), column(read.v)];
  if (line.kind === "bound" && times.length > 0) {
    const first = line.t[0] ?? times[0];
    line.t.splice(0, 2, first, times.at(-1)); // in place, here and below: plots hold on to these lists
    line.v.splice(0, 2, values[0], values.at(-1));
    return;
  }
  times.forEach((time, index) => {
    if (line.t.length > 0 && time <= line.t.at(-1) + SOON) return;
    line.t.push(time);
    line.v.push(values[index]);
  });
  if (line.t.length <= MOST_VALUES) return;
  for (const kept of [line.t, line.v]) kept.splice(0, kept.length, ...halved(kept));
}
