"""Figures of a sweep: each measure against the factors. They need matplotlib, which the extra ``figures`` installs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row, measured

__all__ = ["draw"]


def draw(rows: Sequence[Row], factors: Sequence[str], folder: Path) -> list[Path]:
    """Draw means, or shares, with their intervals: a panel for each measure, against the factor with the most values.

    There is a line for each combination of the other factors. Returns the files; raises UsageError where matplotlib is
    not installed.
    """
    pyplot = plotting()
    shown = measured(rows)
    values = {name: list(dict.fromkeys(row[name] for row in rows)) for name in factors}
    across = max(factors, key=lambda name: len(values[name])) if factors else None
    figure, axes = pyplot.subplots(1, len(shown), figsize=(4.5 * len(shown), 3.6), squeeze=False, layout="constrained")
    for axis, (name, centre) in zip(axes[0], shown.items(), strict=True):
        for label, line in _lines(rows, factors, across).items():
            _draw_line(axis, line, across, (name, centre), label)
        axis.set(xlabel=across or "", ylabel=f"{name} in %" if centre == name else name)
        if across and all(isinstance(value, int | float) for value in values[across]) and min(values[across]) > 0:
            axis.set_xscale("log")
    if len(factors) > 1:
        axes[0][0].legend()
    path = folder / "measures.png"
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
    return [path]


def _lines(rows: Sequence[Row], factors: Sequence[str], across: str | None) -> dict[str, list[Row]]:
    lines: dict[str, list[Row]] = {}
    for row in rows:
        label = ", ".join(f"{name} = {row[name]}" for name in factors if name != across)
        lines.setdefault(label, []).append(row)
    return lines


def _draw_line(axis: Any, line: Sequence[Row], across: str | None, measure: tuple[str, str], label: str) -> None:
    name, centre = measure
    known = [row for row in line if row.get(centre) is not None]
    if not known:
        return
    values = [row[across] if across else "all" for row in known]
    centres = np.array([row[centre] for row in known])
    ends = [
        [centres[i] if row[f"{name}_{end}"] is None else row[f"{name}_{end}"] for i, row in enumerate(known)]
        for end in ("ci_low", "ci_high")
    ]
    axis.errorbar(values, centres, yerr=np.abs(np.array(ends) - centres), marker="o", capsize=3, label=label)
