"""The figures of a run by name, each a matplotlib figure, and files of them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from dynpf_protocol.errors import UsageError

from dynpf_experiments.extras import plotting
from dynpf_experiments.pictures.whole import Whole
from dynpf_experiments.plots.animation import animate
from dynpf_experiments.plots.over_time import draw_health, draw_plot
from dynpf_experiments.plots.style import RC
from dynpf_experiments.plots.world import draw_bodies, draw_map, draw_paths, draw_robots, frame, labelled

__all__ = ["FIGURES", "MOVING", "SUFFIXES", "figure", "save"]

ERRORS = ("position_error", "heading_error", "nees")
MOMENTS = 6
SUFFIXES = (".png", ".svg", ".pdf")
MOVING = (".gif", ".mp4")


def trajectory(run: Whole) -> Any:
    """Return the world from above with true, estimated and dead-reckoned paths, start and end."""
    pyplot = plotting()
    drawn, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
    draw_map(axes, run)
    draw_paths(axes, run)
    for track, style in labelled(run):
        if track.role == "estimate" and track.seconds.size:
            colour = style["color"]
            axes.plot(*track.poses[:2, :1], "o", color=colour, ms=6, mfc="none", label="its start")
            axes.plot(*track.poses[:2, -1:], "x", color=colour, ms=7, mew=2, label="its end")
    draw_bodies(axes, run)
    frame(axes, run)
    _legend(drawn, axes)
    return drawn


def errors(run: Whole) -> Any:
    """Return the errors of the estimates over time, with what the filters expect of them."""
    return _over_time(run, [plot for plot in run.plots if plot.key in ERRORS], "neither truth nor estimates")


def filters(run: Whole) -> Any:
    """Return what else is known of the run over time: effective particles, evidence, commands, those of the system."""
    return _over_time(run, [plot for plot in run.plots if plot.key not in ERRORS], "nothing over time")


def health(run: Whole) -> Any:
    """Return how the filters judged themselves over time, above the position errors."""
    if not any(run.health.values()):
        raise UsageError("--figure health: no node of the run says how far its estimate is to be relied on")
    plots = [plot for plot in run.plots if plot.key == "position_error"]
    drawn, axes = plotting().subplots(
        1 + len(plots),
        figsize=(7.2, 1.4 + 2.2 * len(plots)),
        height_ratios=[0.35 * len(run.health), *(2.0 for _ in plots)],
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    draw_health(axes[0, 0], run.health)
    for row, plot in zip(axes[1:, 0], plots, strict=True):
        draw_plot(row, plot)
    axes[-1, 0].set_xlabel("time (s)")
    return drawn


def particles(run: Whole) -> Any:
    """Return the world with particles, estimate and truth at six moments, evenly spaced from the first picture on."""
    stamps = [cloud.seconds for cloud in run.clouds if cloud.seconds.size]
    if not stamps:
        raise UsageError("--figure particles: the run shows no particles")
    seconds = np.unique(np.concatenate(stamps))
    chosen = np.unique(np.linspace(0, seconds.size - 1, min(MOMENTS, seconds.size)).round().astype(int))
    drawn, axes = plotting().subplots(2, 3, figsize=(10.0, 6.6), layout="constrained", sharex=True, sharey=True)
    for place, axis in enumerate(axes.flat):
        if place >= chosen.size:
            axis.set_axis_off()
            continue
        at = float(seconds[chosen[place]])
        draw_map(axis, run, at)
        draw_paths(axis, run, at)
        frame(axis, run)
        draw_robots(axis, run, at)
        axis.set_title(f"{at:.1f} s", loc="left")
        axis.label_outer()
    _legend(drawn, axes.flat[0])
    return drawn


def overview(run: Whole) -> Any:
    """Return trajectory, position error and health in one figure."""
    plots = [plot for plot in run.plots if plot.key in ("position_error", "n_eff")]
    verdicts = {node: spans for node, spans in run.health.items() if spans}
    rows = len(plots) + bool(verdicts)
    drawn = plotting().figure(figsize=(11.0, 4.8), layout="constrained")
    world, beside = drawn.subfigures(1, 2, width_ratios=[1.0, 1.15]) if rows else (drawn.subfigures(1, 1), None)
    axes = world.subplots()
    draw_map(axes, run)
    draw_paths(axes, run)
    draw_bodies(axes, run)
    frame(axes, run)
    _legend(world, axes)
    if beside is not None:
        ratios = [*(2.0 for _ in plots), *([0.4 * len(verdicts)] if verdicts else [])]
        lines = beside.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for row, plot in zip(lines, plots, strict=False):
            draw_plot(row, plot)
        if verdicts:
            draw_health(lines[-1], verdicts)
        lines[-1].set_xlabel("time (s)")
    return drawn


FIGURES: Mapping[str, Callable[[Whole], Any]] = MappingProxyType(
    {
        "overview": overview,
        "trajectory": trajectory,
        "errors": errors,
        "filters": filters,
        "health": health,
        "particles": particles,
    }
)


def figure(run: Whole, name: str) -> Any:
    """Return a figure of a run; raises UsageError for one of no such name, or that the run has nothing for."""
    if name not in FIGURES:
        raise UsageError(f"--figure {name}: no such figure; there are {', '.join(FIGURES)}")
    pyplot = plotting()
    with pyplot.rc_context(dict(RC)):
        return FIGURES[name](run)


def save(run: Whole, name: str, path: Path) -> None:
    """Write a figure, or for .gif and .mp4 the run as it goes, into a file whose ending says how."""
    if path.suffix in MOVING:
        animate(run, path)
        return
    pyplot = plotting()
    drawn = figure(run, name)
    metadata = {".png": {"Software": "dynpf"}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}[path.suffix]
    try:
        with pyplot.rc_context(dict(RC)):
            drawn.savefig(path, metadata=metadata)
    finally:
        pyplot.close(drawn)


def _over_time(run: Whole, plots: Sequence[Any], lacking: str) -> Any:
    if not plots:
        raise UsageError(f"the run has {lacking} to draw")
    size = (7.2, 0.8 + 1.9 * len(plots))
    drawn, axes = plotting().subplots(len(plots), 1, figsize=size, sharex=True, squeeze=False, layout="constrained")
    for row, plot in zip(axes[:, 0], plots, strict=True):
        draw_plot(row, plot)
    axes[-1, 0].set_xlabel("time (s)")
    axes[-1, 0].set_xlim(0.0, max(run.seconds, 1e-3))
    return drawn


def _legend(drawn: Any, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    if unique:
        drawn.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=3, frameon=False, fontsize=7.5)
