// The plane of the map on a screen. A view is {scale, x, y, width, height}: pixels a unit, and what lies in the middle.

/** Return the view that shows bounds [left, bottom, right, top] in a window of width by height pixels. */
export function fit(bounds, width, height) {
  const [left, bottom, right, top] = bounds;
  const scale = Math.min(width / Math.max(right - left, 1e-9), height / Math.max(top - bottom, 1e-9));
  return { scale, x: (left + right) / 2, y: (bottom + top) / 2, width, height };
}

/** Return where a point of the map is on the screen; y goes up in the map and down on the screen. */
export function toScreen(view, x, y) {
  return [view.width / 2 + view.scale * (x - view.x), view.height / 2 - view.scale * (y - view.y)];
}

/** Return which point of the map is at a pixel. */
export function toMap(view, u, v) {
  return [view.x + (u - view.width / 2) / view.scale, view.y - (v - view.height / 2) / view.scale];
}

/** Return the view enlarged by a factor about a pixel, which keeps its point of the map. */
export function zoomed(view, factor, u, v) {
  const [x, y] = toMap(view, u, v);
  const scale = view.scale * factor;
  return { ...view, scale, x: x - (u - view.width / 2) / scale, y: y + (v - view.height / 2) / scale };
}

/** Return the view moved by pixels. */
export function panned(view, du, dv) {
  return { ...view, x: view.x - du / view.scale, y: view.y + dv / view.scale };
}

/** Return the half axes and the direction of the ellipse that lies k standard deviations out. */
export function ellipse(xx, xy, yy, k) {
  const [mean, half] = [(xx + yy) / 2, (xx - yy) / 2];
  const spread = Math.sqrt(half * half + xy * xy);
  return {
    major: k * Math.sqrt(Math.max(mean + spread, 0)),
    minor: k * Math.sqrt(Math.max(mean - spread, 0)),
    angle: Math.atan2(xy, half) / 2,
  };
}

/** Return a round length, 1, 2 or 5 times a power of ten, that is at most so long. */
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((digit) => digit * power).find((length) => length <= most * (1 + 1e-9));
}
