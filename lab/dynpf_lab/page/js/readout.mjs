// What holds at a time in words and pictures beside the world: poses, verdicts, camera frames.

import { held } from "./codec.mjs";
import { words } from "./clock.mjs";
import { styleOf } from "./draw.mjs";
import { told, verdict } from "./world.mjs";

const find = (selector, root) => root.querySelector(selector);

/** Show the poses of a scene as rows of a table. */
export function showReadout(body, scene, t, theme) {
  const rows = told(scene, t).map(({ track, pose, off }) => {
    const row = document.createElement("tr");
    const heading = Number.isNaN(pose.h) ? "-" : ((pose.h * 180) / Math.PI).toFixed(1);
    const cells = [pose.x.toFixed(3), pose.y.toFixed(3), heading];
    const name = track.robot && track.role !== "estimate" ? `${track.name} of ${track.robot}` : track.name;
    [name, ...cells, off === null ? "" : off.toFixed(3)].forEach((cell, at) => {
      const place = document.createElement(at === 0 ? "th" : "td");
      if (at === 0) place.scope = "row";
      place.textContent = cell;
      row.append(place);
    });
    row.dataset.role = track.role;
    row.firstChild.style.borderLeftColor = styleOf(scene, track, theme).colour;
    return row;
  });
  body.replaceChildren(...rows);
}

/** Show the verdict of a filter on itself. */
export function showVerdict(place, spans, t) {
  const now = verdict(spans, t);
  place.textContent = now ? now[2].replaceAll("_", " ") : "";
}

/** Show the frame of a camera, with the circles that were found in it. */
export function showCamera(figure, camera, t) {
  const at = Math.max(held(camera.t, t), 0);
  if (figure.dataset.at === String(camera.t[at])) return;
  figure.dataset.at = String(camera.t[at]);
  find("image", figure).setAttribute("href", camera.src[at]);
  const circles = camera.circles[at].map(([u, v, radius]) => {
    const circle = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    for (const [name, value] of [["cx", u], ["cy", v], ["r", radius]]) circle.setAttribute(name, String(value));
    return circle;
  });
  find("g", figure).replaceChildren(...circles);
  find(".when", figure).textContent = `${words(camera.t[at])}, ${circles.length} discs`;
}
