// The world of a run on its canvas: fitted, enlarged by buttons or the wheel with Ctrl, moved by dragging with a mouse.

import { draw } from "./draw.mjs";
import { fit, panned, zoomed } from "./geometry.mjs";

const STEP = 1.25;

/** Return what shows a scene on a canvas: draw(t, colours, shown), fit, zoom and resize. */
export function stageOf(canvas, scene, redraw) {
  const context = canvas.getContext("2d");
  let view = null;
  let own = false; // the viewer has chosen what is seen
  const stage = {
    resize() {
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      const density = globalThis.devicePixelRatio || 1;
      [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
      context.setTransform(density, 0, 0, density, 0, 0);
      view = own ? { ...view, width, height } : fit(scene.bounds, width, height);
    },
    draw(t, colours, shown) {
      if (view.width > 0 && view.height > 0) draw(context, scene, view, t, colours, shown);
    },
    fit() {
      own = false;
      view = fit(scene.bounds, canvas.clientWidth, canvas.clientHeight);
      redraw();
    },
    zoom(steps, u = canvas.clientWidth / 2, v = canvas.clientHeight / 2) {
      own = true;
      view = zoomed(view, STEP ** steps, u, v);
      redraw();
    },
  };
  listen(canvas, stage, (du, dv) => {
    own = true;
    view = panned(view, du, dv);
    redraw();
  });
  return stage;
}

function listen(canvas, stage, pan) {
  const fingers = new Map();
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return; // the page scrolls
    event.preventDefault();
    stage.zoom(-Math.sign(event.deltaY), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("dblclick", () => stage.fit());
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (event.pointerType === "mouse") canvas.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel", "pointerleave"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (event.pointerType === "mouse") pan(event.offsetX - before[0], event.offsetY - before[1]);
  });
}
