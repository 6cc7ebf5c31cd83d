"""Figures of the room studies. They need matplotlib, which the extra ``figures`` installs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row

from dynpf.maps.occupancy import OCCUPIED
from dynpf_systems.rooms.studies.ways import Epoch, Track, World, dead_reckoning

__all__ = ["Shown", "draw"]


class Shown(NamedTuple):
    """The run of a filter to be drawn, and its name."""

    name: str
    track: Track


def draw(world: World, epochs: Sequence[Epoch], shown: Sequence[Shown], rows: list[Row], folder: Path) -> list[Path]:
    """Draw success against N, the path on the map, particles over time and errors over time; return the files.

    Raises UsageError where matplotlib is not installed.
    """
    pyplot = plotting()

    return [
        _success(pyplot, rows, folder / "success.png"),
        _way(pyplot, world, epochs, shown[0], folder / "way.png"),
        _particles(pyplot, world, epochs, shown[0], folder / "particles.png"),
        _errors(pyplot, epochs, shown, folder / "errors.png"),
    ]


def _success(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw success against N: a panel for each dataset and case, a line for each start and filter, with 95 % intervals.

    Cases with a single N appear only in the table.
    """
    found = [row for row in rows if "success_percent" in row and row["n"] > 0]
    numbers: dict[tuple[str, str], set[int]] = {}
    for row in found:
        numbers.setdefault((row["dataset"], row["case"]), set()).add(row["n"])
    panels = [panel for panel, several in numbers.items() if len(several) > 1] or list(numbers)[:1]
    figure, axes = pyplot.subplots(
        1, len(panels), figsize=(7.5 * len(panels), 5.2), sharey=True, squeeze=False, layout="constrained"
    )
    for axis, panel in zip(axes[0], panels, strict=True):
        here = [row for row in found if (row["dataset"], row["case"]) == panel]
        for number, kind in enumerate(dict.fromkeys((row["start"], row["filter"]) for row in here)):
            line = [row for row in here if (row["start"], row["filter"]) == kind]
            n = np.array([row["n"] for row in line]) * 1.02**number  # so that intervals do not hide each other
            rate = np.array([row["success_percent"] for row in line])
            low, high = (np.array([row[f"success_percent_{end}"] for row in line]) for end in ("ci_low", "ci_high"))
            style = f"{'os^vDPX*'[number % 8]}-"
            reach = np.abs(np.stack([rate - low, high - rate]))
            axis.errorbar(n, rate, yerr=reach, fmt=style, capsize=3, label=f"{kind[0]} start, {kind[1]}")
        axis.set(
            xscale="log",
            xlabel="particles N",
            ylim=(-3, 103),
            title=f"{panel[0]}: success against the number of particles ({panel[1]})",
        )
        axis.axhline(95.0, color="grey", linestyle=":")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3)
    axes[0, 0].set_ylabel("success in % of trials, 95 % intervals")
    return _saved(pyplot, figure, path)


def _way(pyplot: Any, world: World, epochs: Sequence[Epoch], shown: Shown, path: Path) -> Path:
    truth = _truth(epochs)
    figure, axis = pyplot.subplots(figsize=(7.5, 5.5), layout="constrained")
    _map(axis, world, truth)
    axis.plot(*dead_reckoning(epochs)[:2], ":", color="tab:orange", label="odometry alone")
    axis.plot(*truth[:2], "-", color="black", linewidth=2.5, alpha=0.5, label="truth")
    axis.plot(*shown.track.poses[:2], "-", color="tab:blue", label=f"estimate ({shown.name})")
    axis.plot(*truth[:2, 0], "ko", label="start")
    axis.set(title=f"{world.name}: path", xlabel="x in m", ylabel="y in m")
    figure.legend(fontsize=8, loc="outside lower center", ncols=4)
    return _saved(pyplot, figure, path)


def _particles(pyplot: Any, world: World, epochs: Sequence[Epoch], shown: Shown, path: Path) -> Path:
    truth = _truth(epochs)
    times = [0, 3, 10, len(epochs) - 1]
    figure, axes = pyplot.subplots(2, 2, figsize=(9, 7), sharex=True, sharey=True, layout="constrained")
    for axis, time in zip(axes.flat, times, strict=True):
        _map(axis, world, truth)
        axis.plot(*shown.track.clouds[time][:2], ".", color="tab:blue", markersize=3, alpha=0.5, label="particles")
        x, y, theta = truth[:, time]
        axis.plot(x, y, "o", color="tab:red", markersize=9, fillstyle="none", label="robot")
        axis.plot([x, x + 0.6 * np.cos(theta)], [y, y + 0.6 * np.sin(theta)], "-", color="tab:red")
        axis.set(title=f"after update {time + 1}")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=2)
    for axis in axes[-1]:
        axis.set_xlabel("x in m")
    for axis in axes[:, 0]:
        axis.set_ylabel("y in m")
    figure.suptitle(f"{world.name}: particles over time ({shown.name})")
    return _saved(pyplot, figure, path)


def _errors(pyplot: Any, epochs: Sequence[Epoch], shown: Sequence[Shown], path: Path) -> Path:
    truth = _truth(epochs)
    figure, axes = pyplot.subplots(
        len(shown), 1, figsize=(7.5, 2.6 * len(shown)), sharex=True, squeeze=False, layout="constrained"
    )
    for axis, run in zip(axes[:, 0], shown, strict=True):
        error = np.hypot(*(run.track.poses[:2] - truth[:2]))
        update = np.arange(1, error.size + 1)
        axis.fill_between(update, 1e-3, 3.0 * run.track.sigmas, color="tab:blue", alpha=0.2, label="3 sigma")
        axis.plot(update, error, color="black", label="position error")
        axis.set(yscale="log", ylabel="m", ylim=(1e-3, 20.0), title=run.name)
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    axes[-1, 0].set_xlabel("update")
    return _saved(pyplot, figure, path)


def _map(axis: Any, world: World, truth: Any) -> None:
    segments, grid = world.maps.segments, world.maps.grid
    if segments is not None:
        for x1, y1, x2, y2 in segments.segments:
            axis.plot([x1, x2], [y1, y2], "-", color="dimgrey", linewidth=1.2)
    elif grid is not None:
        row, column = np.nonzero(grid.cells == OCCUPIED)
        axis.plot(*grid.to_map(column + 0.5, row + 0.5), ",", color="dimgrey")
        (x1, y1), (x2, y2) = truth[:2].min(axis=1) - 6.0, truth[:2].max(axis=1) + 6.0
        axis.set(xlim=(x1, x2), ylim=(y1, y2))
    axis.set_aspect("equal")


def _truth(epochs: Sequence[Epoch]) -> Any:
    return np.stack([epoch.truth for epoch in epochs], axis=1)


def _saved(pyplot: Any, figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=80, bbox_inches="tight")
    pyplot.close(figure)
    return path
