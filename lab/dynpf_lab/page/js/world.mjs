// A run as it is drawn: its packed columns read once, and what holds at a time.

import { cells, column, held, points } from "./codec.mjs";

/** Return the world of a run's data, ready to be drawn. */
export function world(data) {
  return {
    unit: data.unit,
    bounds: data.bounds,
    moments: column(data.moments.t),
    ticks: column(data.moments.tick),
    grids: data.grids.map((grid) => ({ ...grid, cells: cells(grid) })),
    shapes: data.shapes.map(shape),
    layers: data.layers.map((layer) => ({ t: column(layer.t), shapes: layer.shapes.map((each) => each.map(shape)) })),
    tracks: data.tracks.map(track),
    clouds: data.clouds.map((cloud) => ({ node: cloud.node, t: column(cloud.t), points: points(cloud.p) })),
    readings: data.readings.map((each) => ({ ...each, t: column(each.t), points: points(each.p) })),
    cameras: data.cameras.map((camera) => ({ ...camera, t: column(camera.t) })),
    health: data.health,
  };
}

function shape(packed) {
  const { f: form, w: part, r: radius = 0, s: text = "", c: colour = "" } = packed;
  return { form, part, radius, text, colour, x: column(packed.x), y: column(packed.y) };
}

function track(packed) {
  const [t, x, y, h] = [packed.t, packed.x, packed.y, packed.h].map(column);
  const cov = packed.cov && { xx: column(packed.cov.xx), xy: column(packed.cov.xy), yy: column(packed.cov.yy) };
  const { name, role, robot, radius } = packed;
  return { name, role, robot, radius, t, x, y, h, cov };
}

/** Return the pose of a track that holds at a time, null before the first. */
export function pose(each, t) {
  const index = held(each.t, t);
  return index < 0 ? null : { index, x: each.x[index], y: each.y[index], h: each.h[index] };
}

/** Return the verdict of a filter on itself at a time: [begin, end, status, reason], or undefined. */
export function verdict(spans, t) {
  return spans.findLast((span) => span[0] <= t + 5e-4);
}

/** Return what holds at a time in words: a row for each robot's truth, estimate and odometry. */
export function told(scene, t) {
  return scene.tracks
    .filter((each) => each.role !== "body")
    .map((each) => ({ track: each, pose: pose(each, t) }))
    .filter((row) => row.pose !== null)
    .map((row) => ({ ...row, off: off(scene, row, t) }));
}

/** Return how far a pose is from the truth of its robot, null where there is none. */
function off(scene, row, t) {
  const truth = scene.tracks.find((each) => each.role === "truth" && each.robot === row.track.robot);
  const true_ = truth && row.track !== truth ? pose(truth, t) : null;
  return true_ && Math.hypot(row.pose.x - true_.x, row.pose.y - true_.y);
}
