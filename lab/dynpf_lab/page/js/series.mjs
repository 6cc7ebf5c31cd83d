// The lines of plots as a plotting library takes them: one list of times, and for each line a value or none at each.

import { column } from "./codec.mjs";

/** Return plots by key, each with the lines of all runs; the label of a line then begins with the run's name. */
export function gathered(runs) {
  const plots = new Map();
  runs.forEach((run, index) => {
    for (const plot of run.plots) {
      if (!plots.has(plot.key)) plots.set(plot.key, { ...plot, lines: [] });
      const before = runs.length > 1 ? `${"AB"[index]}: ` : "";
      for (const line of plot.lines) {
        if (runs.length > 1 && index > 0 && line.kind === "bound") continue;
        plots.get(plot.key).lines.push({ ...line, label: before + line.label, run: index });
      }
    }
  });
  return [...plots.values()].filter((plot) => plot.lines.length > 0);
}

/** Return [times, values of the first line, ...] of a plot. A band is two lines: its lower edge, then its upper one. */
export function aligned(plot) {
  const lines = plot.lines.flatMap((line) => {
    const [times, values] = [column(line.t), column(line.v)];
    if (line.kind !== "band") return [{ times, values }];
    const lower = values.map((value) => (plot.signed ? -value : 0 * value));
    return [{ times, values: lower }, { times, values }];
  });
  const all = new Set();
  for (const line of lines) for (const time of line.times) all.add(time);
  const times = [...all].sort((a, b) => a - b);
  const index = new Map(times.map((time, position) => [time, position]));
  const columns = lines.map((line) => {
    const found = new Array(times.length).fill(undefined); // undefined: told nothing, so the line goes on
    line.times.forEach((time, position) => {
      const value = line.values[position];
      found[index.get(time)] = Number.isNaN(value) ? null : value;
    });
    return found;
  });
  return [times, ...columns];
}

/** Return the least and the greatest value of lines that are shown, bands only as far as four times the lines. */
export function range(plot, data) {
  let [low, high, bandLow, bandHigh] = [Infinity, -Infinity, 0, 0];
  let position = 1;
  for (const line of plot.lines) {
    const columns = line.kind === "band" ? [data[position], data[position + 1]] : [data[position]];
    position += columns.length;
    if (line.hidden) continue;
    for (const value of columns.flat()) {
      if (value === null || value === undefined) continue;
      if (line.kind === "band") [bandLow, bandHigh] = [Math.min(bandLow, value), Math.max(bandHigh, value)];
      else [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
  }
  if (low > high) [low, high] = [bandLow, bandHigh];
  const reach = 4 * Math.max(Math.abs(low), Math.abs(high));
  low = Math.min(low, Math.max(bandLow, -reach));
  high = Math.max(high, Math.min(bandHigh, reach));
  const margin = 0.06 * (high - low || Math.abs(high) || 1);
  return [plot.signed ? low - margin : Math.min(0, low), high + margin];
}

/** Return a sentence that says what the lines of a plot show: their least, greatest and last values. */
export function told(plot) {
  const texts = plot.lines.filter((line) => line.kind === "line").slice(0, 6).map((line) => {
    const values = column(line.v).filter((value) => !Number.isNaN(value));
    if (values.length === 0) return `${line.label}: no values`;
    let [low, high] = [Infinity, -Infinity];
    for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    return `${line.label}: ${figure(low)} to ${figure(high)}, at last ${figure(values.at(-1))}`;
  });
  return `${plot.title}${plot.unit ? `, ${plot.unit}` : ""}. ${texts.join("; ")}.`;
}

/** Return a number with four significant digits. */
export function figure(value) {
  return Number(value.toPrecision(4)).toString();
}
