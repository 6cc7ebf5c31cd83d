"""Measures of a robot's localization: the estimate against the truth, or against a log's reference.

The measures are those of the node ``estimator``; where a run has several estimators, ``estimators`` maps each name to
its measures.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from dynpf_experiments.measures import Measures
from dynpf_experiments.messages import RunMessages, Timed, of_type, planar_poses, seconds
from dynpf_protocol.messages import Estimate, PoseInFrame, RobotState
from numpy.typing import NDArray

from dynpf.metrics.consistency import mean_square, nees
from dynpf.metrics.trajectory import Trajectory, pose_errors, score, thin
from dynpf.types import FloatArray

__all__ = ["FOUND_M", "FOUND_RAD", "LOST_M", "MEASURES", "localization", "reckoned_path", "reference_path"]

STATE = "/state"

FOUND_M, FOUND_RAD = 0.5, math.radians(15.0)
"""Errors of position and heading within which an estimate has found the robot; each study says for how long."""

LOST_M = 1.0
"""The robot counts as lost while the estimate is farther than this from the truth, in metres."""

_SCORED_HZ = 10.0
_MAX_GAP_S = 0.5
_TRUTHS = ("truth/robot", "log/truth")


def localization(run: RunMessages, estimator: str = "estimator") -> dict[str, Any]:
    """Return the measures of an estimator; an empty dictionary where the estimate or the robot's truth is missing.

    The scored estimates are at most ten a second, where the truth has no gap of more than half a second. Where the
    truth is sparser than that throughout, one estimate is scored at each of its poses.

    - ``position_rmse_m``, ``position_median_m``, ``position_p95_m``: distance between estimate and truth, m: root mean
      square, median and 95th percentile
    - ``heading_rmse_rad``: root mean square of the angle between them, rad, where the truth's heading is valid
    - ``lost_fraction``: share of the scored estimates that are farther than ``LOST_M`` from the truth. It says where
      the robot was lost, whether or not the filter detected it
    - ``lost_by_verdict``: share of all estimates whose health status is "lost": how often the filter considered itself
      lost, whether or not it was; runs without health have none
    - ``nees_mean``, ``nees_low``, ``nees_high``: normalized estimation error squared over pose or, where the heading is
      measured, position; its mean and the 95 % band of that for an honest filter
    - ``dead_reckoning_rmse_m``: position_rmse_m of odometry alone
    """
    robot, slash, _ = estimator.rpartition("/")
    truth = next((robot + slash + name for name in _TRUTHS if run.topic(robot + slash + name)), None)
    estimated = run.topic(f"{estimator}/state") if truth is not None else []
    if truth is None or len(run.topic(truth)) < 2 or not estimated:
        return {}
    reference, valid = reference_path(run, truth)
    estimates = of_type(estimated, Estimate)
    chosen, max_gap = _scored(estimated, run.topic(truth))
    poses = np.array([(estimate.x, estimate.y, estimate.theta) for estimate in estimates]).T[:, chosen]
    path = Trajectory(seconds(estimated)[chosen], poses)
    scored = score(path, reference, heading_valid=valid, max_gap=max_gap)
    errors = pose_errors(path, reference, heading_valid=valid, max_gap=max_gap)
    distance = np.hypot(*errors.errors[:2])[errors.position_valid]
    measures: dict[str, Any] = {
        "position_rmse_m": scored.position_rmse_m,
        "position_median_m": scored.position_median_m,
        "position_p95_m": scored.position_p95_m,
        "heading_rmse_rad": scored.heading_rmse_rad,
        "lost_fraction": float(np.mean(distance > LOST_M)) if distance.size else np.nan,
    }
    if verdicts := [estimate.health.status for estimate in estimates if estimate.health]:
        measures["lost_by_verdict"] = verdicts.count("lost") / len(verdicts)
    measures |= _consistency(errors.errors, errors.heading_valid, [estimates[index] for index in chosen])
    measures |= _dead_reckoning(run, estimator, reference, truth)
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def reference_path(run: RunMessages, topic: str) -> tuple[Trajectory, NDArray[np.bool_]]:
    """Return the true path in a topic, and where its heading is valid, (T,)."""
    states = of_type(run.topic(topic), RobotState)
    poses = np.array([(state.x, state.y, state.theta) for state in states]).reshape(-1, 3).T
    return Trajectory(seconds(run.topic(topic)), poses), np.array([state.heading_valid for state in states], dtype=bool)


def reckoned_path(run: RunMessages, estimator: str = "estimator") -> Trajectory:
    """Return the path by odometry alone; it has no poses in a run from an unknown start."""
    known = run.topic(f"{estimator}/dead_reckoning")
    return Trajectory(seconds(known), planar_poses(message.pose for message in of_type(known, PoseInFrame)))


def _scored(estimated: list[Timed], truth: list[Timed]) -> tuple[NDArray[np.intp], float]:
    """Return the indices of the estimates that are scored, and the longest gap of the truth to interpolate, s.

    A truth too sparse to interpolate, such as one pose a scan, is compared at its own poses, each with the first
    estimate of the same stamp that follows it.
    """
    if np.median(np.diff(seconds(truth))) <= _MAX_GAP_S:
        return thin(seconds(estimated), _SCORED_HZ), _MAX_GAP_S
    poses = iter(sorted(truth, key=lambda timed: timed.number))
    pose = next(poses, None)
    due_ns: int | None = None
    chosen: set[int] = set()
    for timed in sorted(estimated, key=lambda timed: timed.number):
        while pose is not None and pose.number < timed.number:
            due_ns, pose = pose.stamp_ns, next(poses, None)
        if timed.stamp_ns == due_ns:
            chosen.add(timed.number)
            due_ns = None
    return np.flatnonzero([timed.number in chosen for timed in estimated]), np.inf


def _consistency(errors: FloatArray, valid: NDArray[np.bool_], estimates: list[Estimate]) -> dict[str, float]:
    covariances = np.array([estimate.covariance for estimate in estimates]).reshape(-1, 3, 3)
    # A measured heading has no variance: then only the position is judged.
    dimension = 3 if np.all(covariances[:, 2, 2] > 0.0) else 2
    values = nees(errors[:dimension, valid], covariances[valid][:, :dimension, :dimension])
    if np.isnan(values).all():
        return {}
    judged = mean_square(values, dimension)
    return {"nees_mean": judged.figure, "nees_low": judged.low, "nees_high": judged.high}


def _dead_reckoning(run: RunMessages, estimator: str, reference: Trajectory, truth: str) -> dict[str, float]:
    known = run.topic(f"{estimator}/dead_reckoning")
    if not known:
        return {}
    chosen, max_gap = _scored(known, run.topic(truth))
    path = reckoned_path(run, estimator)
    chosen_path = Trajectory(path.stamps[chosen], path.poses[:, chosen])
    return {"dead_reckoning_rmse_m": score(chosen_path, reference, max_gap=max_gap).position_rmse_m}


def _measured(run: RunMessages) -> dict[str, Any]:
    names = [topic.removesuffix(STATE) for topic in run.carrying(Estimate) if topic.endswith(STATE)]
    beside_one_another = {"estimators": {name: localization(run, name) for name in names}} if len(names) > 1 else {}
    return localization(run) | beside_one_another


def _lines(measures: Mapping[str, Any]) -> list[str]:
    lines = []
    if "position_rmse_m" in measures:
        text = f"position    RMSE {measures['position_rmse_m']:.4f} m, median {measures['position_median_m']:.4f} m"
        if "dead_reckoning_rmse_m" in measures:
            text += f"; odometry alone {measures['dead_reckoning_rmse_m']:.3f} m"
        lines.append(text)
    if "heading_rmse_rad" in measures:
        lines.append(f"heading     RMSE {np.degrees(measures['heading_rmse_rad']):.2f} deg")
    return lines + (_table(measures["estimators"]) if "estimators" in measures else [])


def _table(estimators: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a line for each estimator of a run: position and heading errors, and how consistent it is."""
    width = max(len(name) for name in (*estimators, "estimator"))
    rows = [f"{'estimator':<{width}}  RMSE m  median m  heading deg   NEES  lost"]
    for name, figures in estimators.items():
        cells = (
            f"{figures.get('position_rmse_m', np.nan):6.4f}",
            f"{figures.get('position_median_m', np.nan):8.4f}",
            f"{np.degrees(figures.get('heading_rmse_rad', np.nan)):11.2f}",
            f"{figures.get('nees_mean', np.nan):5.2f}",
            f"{100.0 * figures.get('lost_fraction', np.nan):3.0f}%",
        )
        rows.append("  ".join((f"{name:<{width}}", *cells)))
    return rows


MEASURES = Measures(
    estimate=Estimate, reads=(RobotState, Estimate, PoseInFrame), truths=_TRUTHS, of_run=_measured, lines=_lines
)
