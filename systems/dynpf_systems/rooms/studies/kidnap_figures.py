"""Figures of the study of lost robots. They need matplotlib, which the extra ``figures`` installs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.extras import plotting

from dynpf.maps.map_server import decode
from dynpf_systems.rooms.studies.laser_logs import LaserLog
from dynpf_systems.rooms.studies.laser_runs import Moment

__all__ = ["Story", "draw"]

COLOURS = {
    "tracking": "tab:green",
    "uncertain": "tab:orange",
    "lost": "tab:red",
    "kidnapped": "tab:purple",
    "map_does_not_fit": "black",
}
"""Colours of the verdicts."""

TITLES = {"tracking": "from a known start", "global": "without a known start", "kidnapped": "carried off"}


MARGIN_M = 3.0
"""Margin of the map around the robot's path, m."""


class Story(NamedTuple):
    """The course of a trial by scans: before the kidnapping, if there is one, and after it."""

    log: LaserLog
    before: Sequence[Moment]
    after: Sequence[Moment]


def draw(stories: Mapping[tuple[str, str], Story], folder: Path) -> list[Path]:
    """Draw each trial, by data set and case, on its map and over time; return the files.

    Raises UsageError where matplotlib is not installed.
    """
    pyplot = plotting()

    return [_story(pyplot, name, case, story, folder) for (name, case), story in stories.items()]


def _story(pyplot: Any, name: str, case: str, story: Story, folder: Path) -> Path:
    figure = pyplot.figure(figsize=(11, 5), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.2, 1.0))
    chart = figure.add_subplot(grid[:, 0])
    rows = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    moments = [*story.before, *story.after]
    _on_the_map(chart, story, moments)
    scans = np.arange(len(moments)) - len(story.before)
    position, heading = np.array([moment.errors for moment in moments]).T
    for axis, values, label in zip(
        rows, (position, np.degrees(heading)), ("position error, m", "heading error, deg"), strict=False
    ):
        axis.semilogy(scans, values, color="grey", linewidth=0.7)
        for status, colour in COLOURS.items():
            chosen = np.array([moment.status == status for moment in moments])
            axis.semilogy(scans[chosen], values[chosen], ".", color=colour, markersize=4)
        axis.set_ylabel(label, fontsize=8)
    sigmas = [float(np.sqrt(np.linalg.eigvalsh(moment.covariance[:2, :2])[-1])) for moment in moments]
    rows[2].semilogy(scans, sigmas, color="tab:blue")
    rows[2].set(xlabel="scan, counted from the first" + (" after the kidnapping" if story.before else ""))
    rows[2].set_ylabel("position sigma, m", fontsize=8)
    for axis in rows:
        if story.before:
            axis.axvline(-0.5, color="black", linestyle=":")
        axis.sharex(rows[2])
    figure.suptitle(f"{name}: {TITLES[case]}")
    figure.legend(*chart.get_legend_handles_labels(), loc="outside lower left", fontsize=8, ncols=3)
    path = folder / f"{name}-{case}.png"
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
    return path


def _on_the_map(axis: Any, story: Story, moments: Sequence[Moment]) -> None:
    facts = story.log.facts
    if facts.map is not None:
        grid = decode(facts.files[facts.map].decode(), lambda name: facts.files[name], facts.map)
        row, column = np.nonzero(grid.occupied)
        axis.plot(*grid.to_map(column + 0.5, row + 0.5), "s", color="black", markersize=0.6)
    true = np.array([moment.true for moment in moments]).T
    axis.plot(true[0], true[1], ".", color="tab:blue", markersize=2, label="reference", zorder=3)
    known = [moment for moment in moments if moment.estimate is not None]
    poses = np.array([moment.estimate for moment in known]).T
    for status, colour in COLOURS.items():
        chosen = np.array([moment.status == status for moment in known])
        if chosen.any():
            label = f"estimate: {status.replace('_', ' ')}"
            axis.plot(*poses[:2, chosen], "o", markerfacecolor="none", color=colour, markersize=5, label=label)
    if story.before:
        last, first = story.before[-1].true, story.after[0].true
        axis.annotate("", first[:2], last[:2], arrowprops={"arrowstyle": "->", "linestyle": ":", "color": "black"})
    low, high = true[:2].min(axis=1) - MARGIN_M, true[:2].max(axis=1) + MARGIN_M
    axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m")
