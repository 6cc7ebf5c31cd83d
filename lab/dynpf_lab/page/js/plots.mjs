// Plots over time by uPlot, which the page brings along.

import { aligned, gathered, range, told } from "./series.mjs";

const HEIGHT = 190; // px
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];

/** Make the plots of all runs inside an element; `seek(t)` is called where a plot is clicked. Returns functions. */
export function plotsOf(place, runs, theme, seek) {
  const made = gathered(runs).map((plot) => make(place, plot, theme, seek));
  return {
    /** Mark the present time. */
    mark: (t) => made.forEach((each) => each.mark(t)),
    /** Fit the plots into the width that they have. */
    resize: () => made.forEach((each) => each.resize()),
    /** Show lines that have grown. */
    update: () => made.forEach((each) => each.update()),
    /** Remove the plots, for others in another theme. */
    remove: () => made.forEach((each) => each.remove()),
  };
}

function make(place, plot, theme, seek) {
  const figure = document.createElement("figure");
  figure.className = "plot";
  const caption = document.createElement("figcaption");
  const title = document.createElement("b");
  title.textContent = plot.unit ? `${plot.title} (${plot.unit})` : plot.title;
  caption.append(title, plot.about ? ` ${plot.about}` : "");
  const stage = document.createElement("div");
  stage.setAttribute("role", "img");
  stage.setAttribute("aria-label", told(plot));
  figure.append(caption, stage);
  place.append(figure);
  let data = aligned(plot);
  const chart = new globalThis.uPlot(options(plot, theme, stage.clientWidth, () => data), data, stage);
  const now = document.createElement("div");
  now.className = "now";
  chart.over.append(now);
  chart.over.addEventListener("click", () => {
    if (chart.cursor.left >= 0) seek(chart.posToVal(chart.cursor.left, "x"));
  });
  return {
    mark: (t) => {
      const left = chart.valToPos(t, "x");
      now.hidden = !(left >= 0 && left <= chart.over.clientWidth);
      now.style.transform = `translateX(${left}px)`;
    },
    update: () => {
      data = aligned(plot);
      chart.setData(data);
    },
    resize: () => chart.setSize({ width: stage.clientWidth, height: HEIGHT }),
    remove: () => {
      chart.destroy();
      figure.remove();
    },
  };
}

function options(plot, theme, width, dataOf) {
  const { series, bands } = lines(plot, theme);
  const axis = { stroke: theme.ink, grid: { stroke: theme.grid, width: 1 }, ticks: { stroke: theme.grid, width: 1 } };
  return {
    width,
    height: HEIGHT,
    padding: [8, 8, 0, 0],
    cursor: { drag: { x: true, y: false }, sync: { key: "time" }, points: { size: 6 } },
    legend: { live: true },
    scales: { x: { time: false }, y: { range: () => range(plot, dataOf()) } },
    axes: [{ ...axis, values: (_, ticks) => ticks.map((tick) => `${tick} s`) }, { ...axis, size: 56 }],
    series: [{ label: "t", value: (_, value) => (value === null ? "-" : `${value.toFixed(2)} s`) }, ...series],
    bands,
    hooks: {
      setSeries: [
        (chart, index) => {
          if (index === null) return;
          const line = chart.series[index]?.line;
          if (line) line.hidden = !chart.series[index].show;
        },
      ],
    },
  };
}

/** Return uPlot's series and bands; a band is filled between two lines without a stroke of their own. */
function lines(plot, theme) {
  const [series, bands] = [[], []];
  let number = 0;
  for (const line of plot.lines) {
    const common = { line, show: !line.hidden, spanGaps: false, points: { show: false }, value };
    if (line.kind === "band") {
      const first = series.length + 1;
      const fill = plot.lines.length > 3 ? "transparent" : theme.band;
      series.push({ ...common, label: line.label, class: "edge", stroke: theme.bandEdge, width: 1, dash: [3, 3] });
      series.push({ ...common, label: line.label, stroke: theme.bandEdge, width: 1, dash: [3, 3] });
      bands.push({ series: [first + 1, first], fill });
    } else if (line.kind === "bound") {
      series.push({ ...common, label: line.label, stroke: theme.ink, width: 1, dash: [6, 6] });
    } else {
      const stroke = theme.several[number % theme.several.length];
      series.push({ ...common, label: line.label, stroke, width: 1.6, dash: DASHES[number % DASHES.length] });
      number += 1;
    }
  }
  return { series, bands };
}

function value(_, number) {
  return number === null || number === undefined ? "-" : Number(number.toPrecision(4)).toString();
}
