"""Figures of the landmark study. They need matplotlib, which the extra ``figures`` installs."""

from pathlib import Path
from typing import Any

import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row

from dynpf.metrics.trajectory import pose_errors
from dynpf_systems.rooms.studies.landmark_logs import LandmarkLog, Run

__all__ = ["draw"]

_BOUND = 2.448  # radius, in standard deviations, of the circle that holds 95 % of an isotropic planar Gaussian


def draw(log: LandmarkLog, run: Run, rows: list[Row], folder: Path) -> list[Path]:
    """Draw a run over a whole log, on its landmarks and over time, and the error against the number of particles.

    Returns the files. Raises UsageError where matplotlib is not installed.
    """
    pyplot = plotting()

    written = [
        _trajectory(pyplot, log, run, folder / "trajectory.png"),
        _error(pyplot, log, run, folder / "error-over-time.png"),
    ]
    counted = [row for row in rows if row["experiment"] == "particles"]
    if len({row["n"] for row in counted}) > 1:
        written.append(_particles(pyplot, counted, folder / "error-against-n.png"))
    return written


def _trajectory(pyplot: Any, log: LandmarkLog, run: Run, path: Path) -> Path:
    """Draw the reference, odometry alone, and the estimate, among the landmarks."""
    figure, axis = pyplot.subplots(figsize=(7, 7), layout="constrained")
    x, y, _ = _without_gaps(log)
    axis.plot(x, y, color="black", linewidth=1.0, label="reference")
    axis.plot(*run.reckoned.poses[:2], color="tab:orange", linewidth=0.8, linestyle=":", label="odometry alone")
    axis.plot(*run.estimate.poses[:2], color="tab:blue", linewidth=0.8, label="estimate")
    marks = np.array([(mark.x, mark.y) for mark in log.landmarks])
    axis.plot(*marks.T, "^", color="tab:red", markersize=8, label="landmarks")
    for mark in log.landmarks:
        axis.annotate(str(mark.id), (mark.x, mark.y), xytext=(4, 4), textcoords="offset points", fontsize=8)
    low, high = (bound([marks.min(axis=0), marks.max(axis=0)], axis=0) for bound in (np.min, np.max))
    axis.set(
        title=f"{log.name}: N = 1000",
        xlabel="x in m",
        ylabel="y in m",
        aspect="equal",
        xlim=(low[0] - 1.5, high[0] + 1.5),
        ylim=(low[1] - 1.5, high[1] + 1.5),
    )
    figure.legend(loc="outside lower center", ncols=4)
    return _saved(pyplot, figure, path)


def _without_gaps(log: LandmarkLog) -> Any:
    """Return the reference with NaN in its gaps, so that no line is drawn across them."""
    poses = log.truth.poses.copy()
    poses[:, np.flatnonzero(np.diff(log.truth.stamps) > 0.5)] = np.nan
    return poses


def _error(pyplot: Any, log: LandmarkLog, run: Run, path: Path) -> Path:
    """Draw errors of position and heading over time, the position's with the estimator's own standard deviation."""
    errors = pose_errors(run.estimate, log.truth, heading_valid=log.heading_valid)
    seconds = run.estimate.stamps - log.start_ns * 1e-9
    position = np.where(errors.position_valid, np.hypot(*errors.errors[:2]), np.nan)
    turned = np.where(errors.heading_valid, np.degrees(errors.errors[2]), np.nan)
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    above.fill_between(seconds, 0.0, _BOUND * run.sigma, color="0.85", label="95 % by the estimator")
    above.plot(seconds, position, color="tab:blue", linewidth=0.8, label="error")
    above.set(ylabel="position in m", ylim=(0.0, max(0.5, 1.1 * float(np.nanmax(position)))))
    above.set_title(f"{log.name}: error over time, N = 1000 (no line: the reference is missing or at fault)")
    above.legend(loc="upper right")
    below.plot(seconds, turned, color="tab:blue", linewidth=0.8)
    below.axhline(0.0, color="black", linewidth=0.5)
    below.set(ylabel="heading in degrees", xlabel="s since the log's start")
    return _saved(pyplot, figure, path)


def _particles(pyplot: Any, rows: list[Row], path: Path) -> Path:
    """Draw the position error against the number of particles: mean with its interval, and 95th percentile."""
    figure, axis = pyplot.subplots(figsize=(7, 4.5), layout="constrained")
    for name in dict.fromkeys(row["dataset"] for row in rows):
        mine = [row for row in rows if row["dataset"] == name]
        n, mean = ([row[key] for row in mine] for key in ("n", "position_rmse_m_mean"))
        ends = [[row[f"position_rmse_m_{end}"] or row["position_rmse_m_mean"] for row in mine] for end in _ENDS]
        (line,) = axis.plot(n, mean, marker="o", label=f"{name}, mean")
        axis.fill_between(n, *ends, color=line.get_color(), alpha=0.25)
        axis.plot(n, [row["position_rmse_m_p95"] for row in mine], "--", color=line.get_color(), label="95 % of trials")
    axis.set(xscale="log", yscale="log", xlabel="particles N", ylabel="position RMSE in m")
    axis.set_title("Error against the number of particles, known start")
    axis.grid(which="both", alpha=0.3)
    axis.legend()
    return _saved(pyplot, figure, path)


_ENDS = ("ci_low", "ci_high")


def _saved(pyplot: Any, figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path
