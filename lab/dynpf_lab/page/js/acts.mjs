// What a person does to a world, as requests: where things are put, and how a robot is driven by keys.

import { pose } from "./world.mjs";

const KEYS = {
  ArrowUp: [1, 0, 0], ArrowDown: [-1, 0, 0], ArrowLeft: [0, 1, 0], ArrowRight: [0, -1, 0],
  w: [1, 0, 0], s: [-1, 0, 0], a: [0, 1, 0], d: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1],
};

/** Return whether a key drives. */
export function drives(key) {
  return key in KEYS;
}

/** Return the topic of an act on a robot's world. */
export function topicOf(robot, act) {
  return robot ? `${robot}/operator/${act}` : `operator/${act}`;
}

/** Return the act that keys which are held down make, null without any; for a robot that may go in any direction, or not.
 *  It lasts a little longer than until the next one, by a run of this rate. */
export function driven(keys, speed, turn, anyDirection, rate) {
  const held = [...keys].filter(drives).map((key) => KEYS[key]);
  if (held.length === 0) return null;
  const [ahead, left, round] = [0, 1, 2].map((at) => Math.sign(held.reduce((sum, key) => sum + key[at], 0)));
  const lasts_s = Math.min(0.4 * Math.max(rate, 1), 60);
  if (!anyDirection) return { v: speed * ahead, w: turn * Math.sign(left + round), lasts_s };
  const scale = ahead && left ? Math.SQRT1_2 : 1;
  return { vx: -speed * scale * left, vy: speed * scale * ahead, w: turn * round, lasts_s };
}

/** Return the bodies of a scene that have a size, in their order: those are the true ones. */
export function bodies(scene) {
  return scene.tracks.filter((track) => track.role === "body" && track.radius > 0);
}

/** Return what lies at a point, within reach, and may be dragged: the nearest true robot or body; null if nothing. */
export function under(scene, t, x, y, reach, acts) {
  const robots = scene.tracks.filter((track) => track.role === "truth" && acts.includes(topicOf(track.robot, "place")));
  const moved = bodies(scene).filter((track) => acts.includes(topicOf(track.robot, "body")));
  const found = [...robots, ...moved]
    .map((track) => ({ track, at: pose(track, t) }))
    .filter(({ at }) => at !== null)
    .map(({ track, at }) => ({ track, at, off: Math.hypot(at.x - x, at.y - y) }))
    .filter(({ track, off }) => off <= Math.max(track.radius, reach))
    .sort((one, other) => one.off - other.off);
  return found[0] ?? null;
}

/** Return the request that puts a thing of the scene elsewhere. */
export function placed(scene, track, x, y, h) {
  const at = { x: rounded(x), y: rounded(y) };
  if (track.role === "truth") {
    const theta = rounded(Math.atan2(Math.sin(h), Math.cos(h)));
    return { topic: topicOf(track.robot, "place"), act: { ...at, theta } };
  }
  return { topic: topicOf(track.robot, "body"), act: { body: bodies(scene).indexOf(track), ...at } };
}

function rounded(value) {
  return Math.round(value * 1e4) / 1e4;
}
