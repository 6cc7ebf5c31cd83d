"""Figures of the COLON studies. They need matplotlib, which the extra ``figures`` installs."""

from pathlib import Path
from typing import Any

import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row

from dynpf.colon import CASES, UNLISTED, Run
from dynpf_systems.colon.studies.worlds import Change, Filter, Noise, Track, Trial, Tube, follow, grid, run

__all__ = ["draw"]

_ERRORS = ("error_x_percent", "error_y_percent", "error_theta_percent")


def draw(tube: Tube, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    """Draw the errors of a study with their intervals and, in a single tube, each case over time; return the files.

    Raises UsageError where matplotlib is not installed.
    """
    pyplot = plotting()

    written = [_errors(pyplot, rows, folder / "errors.png")]
    cases = [case for case in CASES if tube.family is not None or CASES[case].true in "abc"[: len(tube.files)]]
    trials = {case: _followed(tube, case, "none", "hypotheses", seed) for case in cases}
    written.append(_posteriors(pyplot, tube, trials, folder / "maps-over-time.png"))
    filters: dict[str, Filter] = {"COLON's filter": "seed", "hypotheses": "hypotheses"}
    noisy = {
        title: {case: _followed(tube, case, "3px_5pct", name, seed) for case in cases}
        for title, name in filters.items()
    }
    written.append(_clouds(pyplot, tube, noisy, folder / "cloud-over-time.png"))
    return written


def _followed(tube: Tube, case: int, noise: Noise, name: Filter, seed: int) -> tuple[Run, Track]:
    trial = Trial(tube, Change("a", (CASES[case].true,), CASES[case].told), noise, name, 100, True, seed)
    happened = run(trial)
    return happened, follow(trial, happened)[0]


def _errors(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw bars of the mean errors over all tubes, with confidence intervals and the printed figures."""
    pooled = [row for row in rows if row["tube"] == "all" and "error_x_percent_mean" in row]
    labels = [" ".join(str(row[key]) for key in ("case", "filter", "n", "noise", "start")) for row in pooled]
    figure, axes = pyplot.subplots(1, 3, figsize=(13, 0.25 * len(pooled) + 2), sharey=True, layout="constrained")
    positions = np.arange(len(pooled))
    for axis, name in zip(axes, _ERRORS, strict=True):
        means = np.array([row[f"{name}_mean"] for row in pooled])
        ends = [[row[f"{name}_{end}"] or row[f"{name}_mean"] for row in pooled] for end in ("ci_low", "ci_high")]
        reach = np.abs(np.array(ends) - means)
        axis.barh(positions, means, xerr=reach, color="tab:blue", alpha=0.7)
        printed = [row.get(f"printed_{name}", np.nan) for row in pooled]
        axis.plot(printed, positions, "k|", markersize=10, label="printed")
        axis.set(xscale="log", xlabel=name.replace("_percent", " in %").replace("_", " "))
    axes[0].set_yticks(positions, labels, fontsize=7)
    axes[0].invert_yaxis()
    axes[-1].legend()
    return _saved(pyplot, figure, path)


def _posteriors(pyplot: Any, tube: Tube, trials: dict[int, tuple[Run, Track]], path: Path) -> Path:
    """Draw the posterior over maps against the reading, a panel for each case."""
    figure, axes = pyplot.subplots(len(trials), 1, figsize=(7, 1.7 * len(trials)), sharex=True, layout="constrained")
    for axis, (case, (happened, track)) in zip(np.atleast_1d(axes), trials.items(), strict=True):
        for name in (*"ab", UNLISTED):
            axis.plot([maps[name] for maps in track.maps], marker=".", label=name)
        axis.axvline(tube.route.change + 0.5, color="grey", linestyle=":")
        axis.set(title=f"case {case}: from then on the true map is {happened.maps[-1]}", ylim=(-0.05, 1.05))
        axis.set_ylabel("probability")
    np.atleast_1d(axes)[0].legend()
    np.atleast_1d(axes)[-1].set_xlabel("reading")
    return _saved(pyplot, figure, path)


def _clouds(pyplot: Any, tube: Tube, trials: dict[str, dict[int, tuple[Run, Track]]], path: Path) -> Path:
    """Draw the end of the route and the particles at every reading: a row for each case, a column for each filter."""
    cases = list(next(iter(trials.values())))
    figure, grid_of_axes = pyplot.subplots(
        len(cases), len(trials), figsize=(10, 3.4 * len(cases)), sharex=True, sharey=True, layout="constrained"
    )
    axes = np.reshape(grid_of_axes, (len(cases), len(trials)))
    x, y = tube.route.poses()[:2, tube.route.change :]
    for column, (title, followed) in enumerate(trials.items()):
        for axis, (case, (happened, track)) in zip(axes[:, column], followed.items(), strict=True):
            axis.contour(grid(tube, "a").occupied, levels=[0.5], colors="grey", linewidths=0.8, linestyles="dashed")
            axis.contour(grid(tube, happened.maps[-1]).occupied, levels=[0.5], colors="black", linewidths=1.0)
            for number, particles in enumerate(track.clouds):
                label = "particles" if number == 0 else None
                axis.plot(particles[0], particles[1], ".", color="tab:blue", markersize=3, alpha=0.5, label=label)
            axis.plot(*track.poses[:2], "o", color="tab:red", markersize=5, markerfacecolor="none", label="estimate")
            axis.plot(*happened.poses[:2], "k+", markersize=5, label="true")
            axis.set(title=f"case {case}, {title}", aspect="equal")
            axis.set(xlim=(x.min() - 60, x.max() + 140), ylim=(y.min() - 140, y.max() + 140))
    axes[0, 0].legend(loc="upper left")
    for axis in axes[-1]:
        axis.set_xlabel("x in px")
    for axis in axes[:, 0]:
        axis.set_ylabel("y in px")
    return _saved(pyplot, figure, path)


def _saved(pyplot: Any, figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path
