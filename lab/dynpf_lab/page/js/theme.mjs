// The colours of the page as its style sheet has them, in light and in dark, for what is drawn on canvases.

/** Return the colours of the present theme. */
export function themeOf(root) {
  const style = getComputedStyle(root);
  const get = (name) => style.getPropertyValue(`--${name}`).trim();
  const names = ["truth", "estimate", "odometry", "body", "particles", "readings", "wall", "landmark", "goal", "obstacle"];
  const colours = Object.fromEntries(names.map((name) => [name, get(name)]));
  const [free, occupied, unknown] = ["free", "wall", "unknown"].map((name) => rgba(get(name)));
  return {
    ...colours,
    name: get("theme"),
    drawn: get("ink"),
    ink: get("ink"),
    grid: get("grid"),
    band: get("band"),
    bandEdge: get("band-edge"),
    several: ["estimate", "several-2", "several-3", "several-4", "several-5"].map(get),
    cells: { free, occupied, unknown },
  };
}

/** Return a colour #rrggbb as four bytes. */
export function rgba(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)).concat(255);
}
