"""Figures of the parts studies. They need matplotlib, which the extra ``figures`` installs."""

from pathlib import Path
from typing import Any, get_args

import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row

from dynpf.metrics.rearrangement import robot_bound
from dynpf.types import FloatArray
from dynpf_systems.parts.measures import Course
from dynpf_systems.parts.task import NoisyLevel

__all__ = ["draw_bounds", "draw_measures", "draw_times"]

_MEASURES = (
    ("npl_normalized", "npl / noise-free"),
    ("nrl_normalized", "nrl / noise-free"),
    ("final_error_mean_cm", "final error, mean (cm)"),
    ("rpee_cm", "rpee (cm)"),
    ("ppee_cm", "ppee (cm)"),
)
_NOISES = get_args(NoisyLevel)
# Dark to light, so that they can also be distinguished without colours.
_COLOURS = ("#222222", "#b2182b", "#2166ac", "#e08214", "#1b7837", "#762a83", "#5aae9b")
_MARKS = "osD^vPX"


def draw_measures(rows: list[Row], runs: dict[str, list[Course]], folder: Path) -> list[Path]:
    """Draw measures and success against packing density, and the paths of robot and parts; return the files.

    ``runs`` are, for each layout of goals, a run without a filter and a run with one. Raises UsageError where
    matplotlib is not installed.
    """
    pyplot = plotting()
    return [
        _measures(pyplot, rows, folder / "measures.png"),
        _success(pyplot, rows, folder / "success.png"),
        _trajectories(pyplot, runs, folder / "trajectories.png"),
    ]


def draw_bounds(rows: list[Row], runs: dict[str, list[Course]], folder: Path) -> list[Path]:
    """Draw the RMS error over ``runs`` (by noise) and the bound over time, and their ratio in each cell."""
    pyplot = plotting()
    return [_bound(pyplot, runs, folder / "bound.png"), _ratios(pyplot, rows, folder / "ratios.png")]


def draw_times(rows: list[Row], folder: Path) -> list[Path]:
    """Draw the time of a step against the number of particles."""
    pyplot = plotting()
    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3.6), sharey=True, layout="constrained")
    for axis, stage in zip(axes, ("mate", "move"), strict=True):
        chosen = [row for row in rows if row["stage"] == stage]
        numbers = [row["n"] for row in chosen]
        series = (("printed_filter_ms", "filter, printed"), ("estimator_ms_median", "estimator step, median"))
        for index, (key, label) in enumerate((*series, ("filter_ms_median", "filter alone, median"))):
            axis.plot(numbers, [row[key] for row in chosen], color=_COLOURS[index], marker=_MARKS[index], label=label)
        axis.set(title=f"{stage}-part", xlabel="particles", yscale="log", xticks=numbers)
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("time of a step (ms)")
    axes[0].legend()
    return [_saved(pyplot, figure, folder / "times.png")]


def _measures(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw means with intervals against comp: a row for each noise, a column for each measure, a line a filter."""
    noises = [noise for noise in _NOISES if any(row["noise"] == noise for row in rows)]
    size = (3.0 * len(_MEASURES), 2.5 * len(noises) + 0.5)
    figure, axes = pyplot.subplots(
        max(len(noises), 1), len(_MEASURES), figsize=size, sharex=True, sharey="col", squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axis, (_, label) in zip(axes[0], _MEASURES, strict=True):
        axis.set_title(label, fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("packing density comp")
    for panels, noise in zip(axes, noises, strict=False):
        for axis, (name, _) in zip(panels, _MEASURES, strict=True):
            for index, (title, group) in enumerate(_lines(rows, noise).items()):
                means = np.array([row[f"{name}_mean"] for row in group])
                ends = [[row[f"{name}_ci_{end}"] or row[f"{name}_mean"] for row in group] for end in ("low", "high")]
                style = {"color": _COLOURS[index], "marker": _MARKS[index], "markersize": 4, "capsize": 2}
                density = np.array([row["comp"] for row in group]) + 0.08 * (index - 1.5)  # side by side
                axis.errorbar(density, means, np.abs(np.array(ends) - means), label=title, linewidth=1, **style)
            axis.grid(alpha=0.3)
        panels[0].set_ylabel(f"{noise} noise")
    figure.legend(*axes[0][0].get_legend_handles_labels(), fontsize=9, ncols=6, loc="outside upper center")
    return _saved(pyplot, figure, path)


def _success(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw the share of runs completed without a collision against comp, and PARTS's share without a collision."""
    noises = [noise for noise in _NOISES if any(row["noise"] == noise for row in rows)]
    figure, axes = pyplot.subplots(
        1, max(len(noises), 1), figsize=(3.6 * len(noises) + 0.4, 3.8), sharey=True, squeeze=False, layout="constrained"
    )
    for axis, noise in zip(axes[0], noises, strict=False):
        for index, (title, group) in enumerate(_lines(rows, noise).items()):
            shares = np.array([row["succeeded_25mm_percent"] for row in group])
            ends = [[row[f"succeeded_25mm_percent_ci_{end}"] for row in group] for end in ("low", "high")]
            style = {"color": _COLOURS[index], "marker": _MARKS[index], "markersize": 5, "capsize": 2}
            density = np.array([row["comp"] for row in group]) + 0.08 * (index - 1.5)
            axis.errorbar(density, shares, np.abs(np.array(ends) - shares), label=title, linewidth=1, **style)
            printed = [100.0 - row.get("printed_collided_percent", np.nan) for row in group]
            if not np.isnan(printed).all():
                hollow = {"facecolors": "none", "edgecolors": _COLOURS[index], "marker": _MARKS[index], "s": 45}
                axis.scatter(density, printed, label=f"{title}: PARTS", **hollow)
        axis.set(title=f"{noise} noise", xlabel="packing density comp", ylim=(-3, 103))
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("completed without collision (%)")
    figure.legend(
        *axes[0][0].get_legend_handles_labels(), fontsize=8, ncols=1 + len(noises), loc="outside upper center"
    )
    return _saved(pyplot, figure, path)


def _lines(rows: list[Row], noise: str) -> dict[str, list[Row]]:
    """Return the rows of a noise by filter and number of particles, each in the order of comp."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row["noise"] == noise and "comp" in row:
            particles = f"{row['filter']}, {row['n']} particles" if row["n"] else row["filter"].replace("_", " ")
            found.setdefault("no filter" if row["filter"] == "none" else particles, []).append(row)
    return {title: sorted(group, key=lambda row: float(row["comp"])) for title, group in found.items()}


def _trajectories(pyplot: Any, runs: dict[str, list[Course]], path: Path) -> Path:
    """Draw the paths of robot and parts, a column for each layout: without a filter above, with a filter below."""
    figure, axes = pyplot.subplots(
        2, len(runs), figsize=(3.6 * len(runs), 7.2), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for column, (goals, pair) in enumerate(runs.items()):
        for axis, course, title in zip(axes[:, column], pair, ("no filter", "100 particles"), strict=True):
            _ways(pyplot, axis, course)
            contacts = f", {course.contacts} ticks in contact" if course.contacts else ""
            axis.set_title(f"{goals}, {title}{contacts}", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("x (m)")
    for axis in axes[:, 0]:
        axis.set_ylabel("y (m)")
    return _saved(pyplot, figure, path)


def _ways(pyplot: Any, axis: Any, course: Course) -> None:
    task = course.task
    axis.plot(*course.robot.T, color="0.55", linewidth=0.6, zorder=1)
    axis.add_patch(pyplot.Circle(course.robot[0], task.robot_radius, facecolor="0.8", edgecolor="0.4", zorder=0))
    for part, spec in enumerate(task.parts):
        colour = _COLOURS[1:][part % (len(_COLOURS) - 1)]
        axis.plot(*course.parts[:, part].T, color=colour, linewidth=1.2, zorder=3)
        start = course.parts[0, part]
        axis.add_patch(pyplot.Circle(start, spec.radius, fill=False, linestyle=":", edgecolor=colour, zorder=2))
        axis.add_patch(pyplot.Circle(spec.goal, spec.radius, fill=False, linestyle="--", edgecolor="0.2", zorder=2))
        end = course.parts[-1, part]
        axis.add_patch(pyplot.Circle(end, spec.radius, facecolor=colour, alpha=0.35, edgecolor=colour, zorder=2))
    half = (task.width / 2.0, task.height / 2.0)
    axis.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")


def _bound(pyplot: Any, runs: dict[str, list[Course]], path: Path) -> Path:
    """Draw the RMS over runs of the error and of the bound at each tick, a panel for each noise."""
    figure, axes = pyplot.subplots(
        len(runs), 1, figsize=(8, 2.3 * len(runs) + 0.4), sharex=True, squeeze=False, layout="constrained"
    )
    for axis, (noise, courses) in zip(axes[:, 0], runs.items(), strict=True):
        ticks = min(len(course.errors) for course in courses)
        bounds = [robot_bound(course.information[:ticks], course.noise.process) for course in courses]
        seconds = courses[0].tick_s * np.arange(ticks)
        errors = np.array([np.linalg.norm(course.errors[:ticks], axis=1) for course in courses])
        raw = 100.0 * np.sqrt(2.0 * courses[0].noise.measurement)
        axis.axhline(raw, color="0.5", linestyle=":", label="a measurement's RMS error")
        axis.plot(seconds, _rms(errors), color=_COLOURS[2], linewidth=0.8, label=f"RMS error, {len(courses)} runs")
        noisy, noiseless = (np.array([getattr(bound, name) for bound in bounds]) for name in ("noisy", "noiseless"))
        axis.plot(seconds, _rms(noisy), color=_COLOURS[1], linewidth=1.6, label="bound (eq. 3.35)")
        axis.plot(seconds, _rms(noiseless), color=_COLOURS[0], linestyle="--", label="no process noise (eq. 3.38)")
        held = np.mean([course.held[:ticks] >= 0 for course in courses], axis=0)
        axis.fill_between(
            seconds, 0.0, held * raw, color="#fdb863", alpha=0.35, linewidth=0, label="share in move-part"
        )
        axis.set(ylabel=f"{noise} noise: cm", ylim=(0.0, 1.1 * raw), xlim=(0.0, seconds[-1]))
    figure.legend(*axes[0][0].get_legend_handles_labels(), fontsize=8, ncols=3, loc="outside upper center")
    axes[-1][0].set_xlabel("time (s)")
    return _saved(pyplot, figure, path)


def _ratios(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw the ratio of RMS error and bound in each cell and stage, with intervals."""
    chosen = [row for row in rows if row["goals"] != "all"]
    cells = list(dict.fromkeys((row["parts"], row["goals"], row["noise"], row["filter"]) for row in chosen))
    figure, axis = pyplot.subplots(figsize=(6, 0.3 * len(cells) + 1.2), layout="constrained")
    for index, stage in enumerate(("mate", "move", "all")):
        group = [row for row in chosen if row["stage"] == stage]
        at = [
            cells.index((row["parts"], row["goals"], row["noise"], row["filter"])) + 0.2 * (index - 1) for row in group
        ]
        means = np.array([row["crlb_ratio_mean"] for row in group])
        ends = [[row[f"crlb_ratio_ci_{end}"] or row["crlb_ratio_mean"] for row in group] for end in ("low", "high")]
        style = {"color": _COLOURS[index], "marker": _MARKS[index], "markersize": 4, "linestyle": "none"}
        axis.errorbar(means, at, xerr=np.abs(np.array(ends) - means), label=stage, **style)
    axis.axvline(1.0, color="0.4", linewidth=0.8)
    axis.set_yticks(range(len(cells)), [f"{parts} {goals}, {noise}, {name}" for parts, goals, noise, name in cells])
    axis.set_xlabel("RMS error over the Cramer-Rao bound")
    axis.invert_yaxis()
    axis.grid(alpha=0.3, axis="x")
    axis.legend(fontsize=8)
    return _saved(pyplot, figure, path)


def _rms(values: FloatArray) -> FloatArray:
    """Return the root mean square over runs, (T,) in cm, of values (runs, T) in metres."""
    return np.asarray(100.0 * np.sqrt(np.mean(values**2, axis=0)))


def _saved(pyplot: Any, figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
    return path
