// The world of a run on its canvas: fitted, enlarged by buttons or the wheel with Ctrl, moved by dragging with a mouse.

import { draw } from "./draw.mjs";
import { fit, panned, toMap, zoomed } from "./geometry.mjs";

const STEP = 1.25;

/** Return what shows a scene on a canvas: draw(t, colours, shown), fit, zoom and resize.
 *  `grip` takes what lies under the pointer, if anything may be dragged there: take(x, y, reach), move, drop, turn. */
export function stageOf(canvas, scene, redraw, grip = null) {
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
    /** Draw something over the scene. */
    over: (paint) => paint(context, view),
    /** Return the point of the map at a pixel, and how much a pixel is there. */
    at: (u, v) => [...toMap(view, u, v), 1 / view.scale],
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
  }, grip);
  return stage;
}

const REACH = 14; // px, for what is dragged

function listen(canvas, stage, pan, grip) {
  const fingers = new Map();
  let held = null; // the finger that drags something
  canvas.addEventListener("wheel", (event) => {
    if (held !== null) {
      event.preventDefault();
      grip.turn(-Math.sign(event.deltaY));
      return;
    }
    if (!event.ctrlKey && !event.metaKey) return; // the page scrolls
    event.preventDefault();
    stage.zoom(-Math.sign(event.deltaY), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("dblclick", () => stage.fit());
  canvas.addEventListener("pointerdown", (event) => {
    const [x, y, pixel] = stage.at(event.offsetX, event.offsetY);
    if (held === null && grip?.take(x, y, REACH * pixel)) {
      held = event.pointerId;
      canvas.setPointerCapture(held);
      return;
    }
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (event.pointerType === "mouse") canvas.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel", "pointerleave"]) {
    canvas.addEventListener(name, (event) => {
      fingers.delete(event.pointerId);
      if (event.pointerId !== held) return;
      held = null;
      grip.drop(name === "pointerup");
    });
  }
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerId === held) {
      grip.move(...stage.at(event.offsetX, event.offsetY));
      return;
    }
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (event.pointerType === "mouse") pan(event.offsetX - before[0], event.offsetY - before[1]);
  });
}
