// Draws a world from above on a canvas, at a time.

import { held } from "./codec.mjs";
import { ellipse, roundLength, toMap, toScreen } from "./geometry.mjs";
import { pose } from "./world.mjs";

const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const MOST_DASHED = 400; // poses
const LEAST_ROBOT = 7; // px, so that a robot is seen in a large map

/** Draw what holds at time t. `shown` has the names of the parts that are wanted, `colours` those of the theme. */
export function draw(context, scene, view, t, colours, shown) {
  context.clearRect(0, 0, view.width, view.height);
  context.lineJoin = "round";
  context.lineCap = "round";
  drawRuler(context, view, colours);
  if (shown.has("map")) {
    for (const grid of scene.grids) drawGrid(context, grid, view, colours);
    for (const shape of scene.shapes) drawShape(context, shape, view, colours);
    for (const layer of scene.layers) {
      for (const shape of layer.shapes[held(layer.t, t)] ?? []) drawShape(context, shape, view, colours);
    }
  }
  for (const track of scene.tracks) if (shown.has(track.role)) drawPath(context, scene, track, view, t, colours);
  if (shown.has("particles")) drawClouds(context, scene, view, t, colours);
  if (shown.has("readings")) drawReadings(context, scene, view, t, colours);
  for (const track of scene.tracks) if (shown.has(track.role)) drawBody(context, scene, track, view, t, colours, shown);
  drawScale(context, view, scene.unit, colours);
}

/** Return the colour and the dash of a track: estimates of several nodes differ in both. */
export function styleOf(scene, track, colours) {
  if (track.role !== "estimate") return { colour: colours[track.role], dash: track.role === "odometry" ? [5, 5] : [] };
  const number = scene.tracks.filter((each) => each.role === "estimate").indexOf(track);
  return { colour: colours.several[number % colours.several.length], dash: DASHES[number % DASHES.length] };
}

function drawRuler(context, view, colours) {
  const step = roundLength(160 / view.scale);
  const [left, bottom] = toMap(view, 0, view.height);
  const [right, top] = toMap(view, view.width, 0);
  context.strokeStyle = colours.grid;
  context.lineWidth = 1;
  context.beginPath();
  for (let x = Math.ceil(left / step) * step; x <= right; x += step) {
    const [u] = toScreen(view, x, 0);
    context.moveTo(u, 0);
    context.lineTo(u, view.height);
  }
  for (let y = Math.ceil(bottom / step) * step; y <= top; y += step) {
    const [, v] = toScreen(view, 0, y);
    context.moveTo(0, v);
    context.lineTo(view.width, v);
  }
  context.stroke();
}

function drawScale(context, view, unit, colours) {
  const length = roundLength(Math.min(130, view.width / 3) / view.scale);
  const [u, v] = [14, view.height - 14];
  context.strokeStyle = context.fillStyle = colours.truth;
  context.lineWidth = 2;
  context.setLineDash([]);
  context.beginPath();
  context.moveTo(u, v);
  context.lineTo(u + length * view.scale, v);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillText(`${Number(length.toPrecision(6))} ${unit}`, u, v - 6);
}

function drawGrid(context, grid, view, colours) {
  grid.image ??= imageOf(grid, colours);
  if (grid.image.theme !== colours.name) grid.image = imageOf(grid, colours);
  const [x, y, yaw] = grid.origin;
  const [u, v] = toScreen(view, x, y);
  context.save();
  context.translate(u, v);
  context.rotate(-yaw);
  context.scale(grid.resolution * view.scale, -grid.resolution * view.scale);
  context.imageSmoothingEnabled = grid.resolution * view.scale < 1;
  context.drawImage(grid.image.canvas, 0, 0);
  context.restore();
}

/** Return a map's cells as a picture in the theme's colours. */
function imageOf(grid, colours) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [grid.w, grid.h];
  const context = canvas.getContext("2d");
  const image = context.createImageData(grid.w, grid.h);
  const shades = [colours.cells.free, colours.cells.occupied, colours.cells.unknown];
  grid.cells.forEach((cell, index) => image.data.set(shades[cell] ?? shades[2], 4 * index));
  context.putImageData(image, 0, 0);
  return { canvas, theme: colours.name };
}

function drawShape(context, shape, view, colours) {
  const colour = shape.colour || colours[shape.part];
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = shape.part === "wall" ? 2.5 : 1.5;
  context.setLineDash(shape.part === "goal" ? [5, 4] : []);
  if (shape.form === "disc") {
    drawDiscs(context, shape, view);
  } else if (shape.form === "text") {
    drawText(context, shape.text, ...toScreen(view, shape.x[0], shape.y[0]));
  } else {
    context.beginPath();
    shape.x.forEach((x, index) => {
      const [u, v] = toScreen(view, x, shape.y[index]);
      if (index === 0 || (shape.form === "pairs" && index % 2 === 0)) context.moveTo(u, v);
      else context.lineTo(u, v);
    });
    if (shape.form === "loop" || shape.form === "area") context.closePath();
    if (shape.form === "area") faintly(context, () => context.fill());
    context.stroke();
  }
  context.setLineDash([]);
}

function drawDiscs(context, shape, view) {
  shape.x.forEach((x, index) => {
    const [u, v] = toScreen(view, x, shape.y[index]);
    const radius = Math.max(shape.radius * view.scale, 4);
    context.beginPath();
    if (shape.part === "landmark") triangle(context, u, v, 6);
    else context.arc(u, v, radius, 0, 2 * Math.PI);
    if (shape.part === "landmark") context.fill();
    else faintly(context, () => context.fill());
    context.stroke();
    if (shape.text) drawText(context, shape.text, shape.part === "landmark" ? u + 11 : u, v);
  });
}

function triangle(context, u, v, size) {
  context.moveTo(u, v - size);
  context.lineTo(u + size * 0.87, v + size / 2);
  context.lineTo(u - size * 0.87, v + size / 2);
  context.closePath();
}

function drawText(context, text, u, v) {
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, u, v);
  context.textBaseline = "alphabetic";
}

/** Draw the whole path thinly, and as far as t in full; of a long dashed one the last part, as dashes take long to draw. */
function drawPath(context, scene, track, view, t, colours) {
  const { colour, dash } = styleOf(scene, track, colours);
  const now = held(track.t, t);
  const from = dash.length ? Math.max(now - MOST_DASHED, 0) : 0;
  context.strokeStyle = colour;
  for (const [begin, end, alpha, width, dashes] of [
    [0, track.t.length - 1, 0.28, 1, []],
    [from, now, 1, track.role === "truth" ? 3 : 1.8, dash],
  ]) {
    context.setLineDash(dashes);
    context.globalAlpha = track.role === "truth" && alpha === 1 ? 0.55 : alpha;
    context.lineWidth = width;
    context.beginPath();
    for (let index = begin; index <= end; index += 1) context.lineTo(...toScreen(view, track.x[index], track.y[index]));
    context.stroke();
  }
  context.globalAlpha = 1;
  context.setLineDash([]);
}

function drawClouds(context, scene, view, t, colours) {
  for (const cloud of scene.clouds) {
    const points = cloud.points[held(cloud.t, t)] ?? [];
    context.fillStyle = colours.particles;
    context.globalAlpha = 0.65;
    for (let at = 0; at < points.length; at += 2) {
      const [u, v] = toScreen(view, points[at], points[at + 1]);
      context.fillRect(u - 1.5, v - 1.5, 3, 3);
    }
    context.globalAlpha = 1;
  }
}

/** Draw the last reading of each sensor, as seen from where the robot was estimated then, and faintly by odometry. */
function drawReadings(context, scene, view, t, colours) {
  for (const reading of scene.readings) {
    const last = held(reading.t, t);
    const points = reading.points[last];
    if (!points) continue;
    if (reading.form === "fix") {
      drawFix(context, points, view, colours.readings);
      continue;
    }
    for (const [role, colour, alpha] of [["odometry", colours.odometry, 0.45], ["estimate", colours.readings, 0.9]]) {
      const track = scene.tracks.find((each) => each.role === role && each.robot === reading.robot);
      const at = track && pose(track, reading.t[last]);
      if (!at) continue;
      context.globalAlpha = alpha;
      context.strokeStyle = context.fillStyle = colour;
      drawSeen(context, reading.form, points, at, view);
      context.globalAlpha = 1;
    }
  }
}

function drawSeen(context, form, points, at, view) {
  const [sine, cosine] = [Math.sin(at.h), Math.cos(at.h)];
  const placed = [];
  for (let index = 0; index < points.length; index += 2) {
    const [x, y] = [points[index], points[index + 1]];
    placed.push(toScreen(view, at.x + cosine * x - sine * y, at.y + sine * x + cosine * y));
  }
  context.lineWidth = form === "segments" ? 3 : 1;
  const [u, v] = toScreen(view, at.x, at.y);
  placed.forEach(([x, y], index) => {
    context.beginPath();
    if (form === "rays") {
      context.moveTo(u, v);
      context.lineTo(x, y);
      context.stroke();
      context.strokeRect(x - 4, y - 4, 8, 8);
    } else if (form === "segments") {
      if (index % 2) return;
      context.moveTo(x, y);
      context.lineTo(...(placed[index + 1] ?? [x, y]));
      context.stroke();
    } else {
      context.arc(x, y, 2.2, 0, 2 * Math.PI);
      context.fill();
    }
  });
}

function drawFix(context, points, view, colour) {
  const [u, v] = toScreen(view, points[0], points[1]);
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.beginPath();
  for (const [du, dv] of [[6, 0], [0, 6]]) {
    context.moveTo(u - du, v - dv);
    context.lineTo(u + du, v + dv);
  }
  context.stroke();
}

function drawBody(context, scene, track, view, t, colours, shown) {
  const at = pose(track, t);
  if (!at) return;
  const { colour } = styleOf(scene, track, colours);
  const [u, v] = toScreen(view, at.x, at.y);
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 2;
  if (track.role === "body") {
    context.beginPath();
    context.arc(u, v, track.radius ? track.radius * view.scale : 2.5, 0, 2 * Math.PI);
    faintly(context, () => context.fill());
    context.stroke();
    if (track.radius * view.scale > 9) drawText(context, track.name.split(" ").at(-1), u, v);
    return;
  }
  if (track.cov && shown.has("ellipse")) drawEllipse(context, track.cov, at.index, u, v, view);
  drawRobot(context, u, v, at.h, Math.max(track.radius * view.scale, LEAST_ROBOT), track.role);
}

/** Draw a robot as a disc with a nose: the true one filled, an estimate open, odometry dashed. */
function drawRobot(context, u, v, h, radius, role) {
  context.setLineDash(role === "odometry" ? [3, 3] : []);
  context.beginPath();
  context.arc(u, v, radius, 0, 2 * Math.PI);
  if (role === "truth") faintly(context, () => context.fill());
  if (!Number.isNaN(h)) {
    context.moveTo(u, v);
    context.lineTo(u + 1.5 * radius * Math.cos(h), v - 1.5 * radius * Math.sin(h));
  }
  context.stroke();
  context.setLineDash([]);
}

/** Draw what a person drags: a robot or a body at {x, y, h}, and the way from where it is. */
export function drawGhost(context, view, ghost, colours) {
  const { track, x, y, h } = ghost;
  const [u, v] = toScreen(view, x, y);
  const [from, to] = [track.x.at(-1), track.y.at(-1)];
  context.save();
  context.strokeStyle = context.fillStyle = colours[track.role];
  context.lineWidth = 2;
  context.setLineDash([2, 4]);
  context.beginPath();
  context.moveTo(...toScreen(view, from, to));
  context.lineTo(u, v);
  context.stroke();
  drawRobot(context, u, v, track.role === "truth" ? h : NaN, Math.max(track.radius * view.scale, LEAST_ROBOT), "truth");
  context.restore();
}

function drawEllipse(context, cov, index, u, v, view) {
  const { major, minor, angle } = ellipse(cov.xx[index], cov.xy[index], cov.yy[index], 3);
  if (!(major > 0)) return;
  context.beginPath();
  context.ellipse(u, v, Math.max(major * view.scale, 1), Math.max(minor * view.scale, 1), -angle, 0, 2 * Math.PI);
  faintly(context, () => context.fill());
  context.stroke();
}

function faintly(context, action) {
  context.save();
  context.globalAlpha *= 0.22;
  action();
  context.restore();
}
