"""Lines over time on a pair of axes, and a filter's verdicts as a band of colours."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynpf_experiments.pictures.drawing import Line, Plot
from dynpf_experiments.pictures.estimates import Span
from dynpf_experiments.plots.style import ESTIMATES, STATUS

__all__ = ["draw_health", "draw_plot"]

BAND, BOUND = "#56b4e9", "#555555"


def draw_plot(axes: Any, plot: Plot) -> None:
    """Draw the lines of a plot that are shown at once, with its title and unit."""
    shown = [line for line in plot.lines if not line.hidden]
    lines = [line for line in shown if line.kind == "line"]
    for line in shown:
        _draw_line(axes, line, ESTIMATES[lines.index(line) % len(ESTIMATES)] if line in lines else BOUND)
    axes.set_title(plot.title, loc="left")
    axes.set_ylabel(plot.unit)
    if not plot.signed:
        axes.set_ylim(bottom=0.0, top=_top(shown))
    if len({line.label for line in shown}) > 1:
        axes.legend(loc="upper right", frameon=False, fontsize=7.5, ncols=3)


def draw_health(axes: Any, health: Mapping[str, Sequence[Span]]) -> None:
    """Draw each node's verdicts as a row of colours, and name them."""
    from matplotlib.patches import Patch  # noqa: PLC0415 - comes with the extra

    rows = [(node, spans) for node, spans in health.items() if spans]
    for row, (_, spans) in enumerate(rows):
        for span in spans:
            colour = STATUS.get(span.status, BOUND)
            axes.barh(row, span.end - span.begin, left=span.begin, height=0.8, color=colour, lw=0)
    axes.set_yticks(range(len(rows)), [node for node, _ in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_title("Health", loc="left")
    axes.grid(visible=False)
    seen = dict.fromkeys(span.status for _, spans in rows for span in spans)
    keys = [Patch(color=STATUS.get(status, BOUND), label=status.replace("_", " ")) for status in seen]
    axes.legend(handles=keys, loc="upper right", frameon=False, fontsize=7.5, ncols=len(keys), bbox_to_anchor=(1, 1.5))


def _draw_line(axes: Any, line: Line, colour: str) -> None:
    if line.kind == "band":
        low = -line.values if np.nanmin(line.values, initial=0.0) < 0.0 else np.zeros_like(line.values)
        axes.fill_between(line.seconds, low, line.values, color=BAND, alpha=0.35, lw=0, label=line.label)
    elif line.kind == "bound":
        axes.plot(line.seconds, line.values, color=colour, lw=0.9, ls="--", label=line.label)
    else:
        axes.plot(line.seconds, line.values, color=colour, lw=1.1, label=line.label)


def _top(lines: Sequence[Line]) -> float | None:
    """Return the top of the axis: a few spikes, as before a filter has converged, leave the rest visible."""
    values = np.concatenate([line.values for line in lines if line.values.size] or [np.zeros(0)])
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    usual = float(np.quantile(known, 0.98))
    return 1.3 * usual if 0.0 < 4.0 * usual < float(known.max()) else None
