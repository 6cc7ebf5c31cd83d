"""Measures of a robot's localization: the estimate against the truth, or against a log's reference.

The measures are those of the node ``estimator``; where a run has several estimators, ``estimators`` maps each name to
its measures.
"""

import math
from typing import Any

import numpy as np
from dynpf_experiments.measures import Measures
from dynpf_experiments.messages import RunMessages, Timed, of_type, planar_poses, seconds
from dynpf_protocol.messages import Estimate, PoseInFrame, RobotState
from msgspec.structs import replace
from numpy.typing import NDArray

from dynpf.filters.health import Status
from dynpf.metrics.alignment import Alignment, alignment, moved_into
from dynpf.metrics.consistency import mean_square, nees
from dynpf.metrics.trajectory import Trajectory, pose_errors, score, thin
from dynpf.types import FloatArray
from dynpf_systems.rooms.fit import estimated_path, fit_of, tracking
from dynpf_systems.rooms.words import LOST_M, lines_of

__all__ = [
    "FOUND_M",
    "FOUND_RAD",
    "LOCALIZED",
    "LOST_M",
    "MEASURES",
    "aligned",
    "localization",
    "reckoned_path",
    "reference_path",
    "wrong_share",
]

STATE = "/state"

FOUND_M, FOUND_RAD = 0.5, math.radians(15.0)
"""Errors of position and heading within which an estimate has found the robot; each study says for how long."""

NO_REFERENCE = "no estimate has a reference"

_SCORED_HZ = 10.0
_MAX_GAP_S = 0.5
LOCALIZED = "log/localized"
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
      lost, whether or not it was; ``tracking_by_verdict`` and so on are those of the other statuses, of the rare ones
      where they occur; runs without health have none
    - ``nees_mean``, ``nees_low``, ``nees_high``: normalized estimation error squared over pose or, where the heading is
      measured, position; its mean and the 95 % band of that for an honest filter
    - ``dead_reckoning_rmse_m``: position_rmse_m of odometry alone
    - ``alignment``: where a rigid motion makes a median error of metres much smaller, ``position_rmse_m`` and
      ``heading_rmse_rad`` after it, and that motion as ``truth_offset``, the pose of the map in the reference's frame
    - ``unscored``: why no estimate could be scored, in words
    """
    truth = _truth_of(run, estimator)
    estimated = run.topic(f"{estimator}/state") if truth is not None else []
    if truth is None or not estimated:
        return {}
    if len(run.topic(truth)) < 2:
        return {"unscored": f"{NO_REFERENCE}: {truth} has one pose; two are needed"}
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
        shares = {status.value: verdicts.count(status.value) / len(verdicts) for status in Status}
        always = (Status.TRACKING, Status.UNCERTAIN, Status.LOST)
        measures |= {f"{name}_by_verdict": share for name, share in shares.items() if share or name in always}
    measures |= _consistency(errors.errors, errors.heading_valid, [estimates[index] for index in chosen])
    measures |= _dead_reckoning(run, estimator, reference, truth)
    found = {name: value for name, value in measures.items() if np.isfinite(value)}
    if not distance.size:
        found["unscored"] = f"{NO_REFERENCE}: {_apart(seconds(estimated), reference.stamps)}"
    elif scored.position_median_m >= LOST_M:
        found |= _alignment(scored.position_median_m, alignment(path, errors))
    return found


def _truth_of(run: RunMessages, estimator: str) -> str | None:
    robot, slash, _ = estimator.rpartition("/")
    return next((robot + slash + name for name in _TRUTHS if run.topic(robot + slash + name)), None)


def _apart(stamps: FloatArray, known: FloatArray) -> str:
    """Return in words why no stamp of an estimate has a reference, both in seconds."""
    if known[-1] < stamps[0]:
        return f"the reference ends {stamps[0] - known[-1]:.1f} s before the first estimate"
    if known[0] > stamps[-1]:
        return f"the reference begins {known[0] - stamps[-1]:.1f} s after the last estimate"
    return f"all estimates are in gaps of the reference of more than {_MAX_GAP_S} s"


def _alignment(median_m: float, found: Alignment | None) -> dict[str, Any]:
    """Return the alignment of an estimate whose error it makes much smaller, over a path with a shape to tell it by."""
    if found is None or not 4.0 * found.position_median_m <= min(median_m, found.extent_m):
        return {}
    figures = {
        "position_rmse_m": found.position_rmse_m,
        "position_median_m": found.position_median_m,
        "heading_rmse_rad": found.heading_rmse_rad,
    }
    finite = {name: value for name, value in figures.items() if np.isfinite(value)}
    return {"alignment": {**finite, "truth_offset": list(found.offset)}}


def aligned(run: RunMessages) -> RunMessages:
    """Return the run with the reference of each estimator moved into the estimate's frame, as well as that can be.

    Where several estimators have one reference, the first says where it goes.
    """
    offsets: dict[str, tuple[float, float, float]] = {}
    for name in _estimators(run):
        truth = _truth_of(run, name)
        if truth is None or len(run.topic(truth)) < 2:
            continue
        reference, _ = reference_path(run, truth)
        path = estimated_path(run, name)
        found = alignment(path, pose_errors(path, reference, max_gap=_longest_gap(run.topic(truth))))
        if found is not None:
            offsets.setdefault(truth, found.offset)

    def read(name: str) -> list[Timed]:
        """Return the messages of a topic, those of a reference moved."""
        messages = run.topic(name)
        if name not in offsets or not messages:
            return messages
        path, _ = reference_path(run, name)
        poses = moved_into(path.poses, offsets[name]).T.tolist()
        states = zip(messages, of_type(messages, RobotState), poses, strict=True)
        return [timed._replace(message=replace(state, x=x, y=y, theta=theta)) for timed, state, (x, y, theta) in states]

    return RunMessages(lambda: run.scenario, run.with_files, read, run.topics)


def _longest_gap(truth: list[Timed]) -> float:
    return _MAX_GAP_S if np.median(np.diff(seconds(truth))) <= _MAX_GAP_S else math.inf


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


def _estimators(run: RunMessages) -> list[str]:
    return [topic.removesuffix(STATE) for topic in run.carrying(Estimate) if topic.endswith(STATE)]


def _measured(run: RunMessages) -> dict[str, Any]:
    names = _estimators(run)
    beside_one_another = {"estimators": {name: localization(run, name) for name in names}} if len(names) > 1 else {}
    return localization(run) | _recorded(run) | beside_one_another


def _with_fit(run: RunMessages) -> dict[str, Any]:
    """Return the measures of a recorded run, each estimator's with how well its readings fit."""
    measured, names = _measured(run), _estimators(run)
    for name in names if len(names) > 1 else ():
        measured["estimators"][name] |= fit_of(run, name)
    return measured | (fit_of(run) if "estimator" in names else {})


def _recorded(run: RunMessages) -> dict[str, Any]:
    """Return the measures of the localization that ran on the robot, if the log has it.

    ``robot_localization`` has ``position_rmse_m``, ``position_median_m`` and ``heading_rmse_rad`` against the
    reference, with ``alignment`` as an estimator has it, and without a reference ``from_ours_median_m``, the distance
    to our estimates.
    """
    if len(run.topic(LOCALIZED)) < 2:
        return {}
    path, _ = reference_path(run, LOCALIZED)
    truth = _truth_of(run, "estimator")
    found: dict[str, Any]
    if truth is not None and len(run.topic(truth)) >= 2:
        reference, valid = reference_path(run, truth)
        gap = _longest_gap(run.topic(truth))
        scored = score(path, reference, heading_valid=valid, max_gap=gap)
        names = ("position_rmse_m", "position_median_m", "heading_rmse_rad")
        found = {name: getattr(scored, name) for name in names if np.isfinite(getattr(scored, name))}
        if scored.position_median_m >= LOST_M:
            errors = pose_errors(path, reference, heading_valid=valid, max_gap=gap)
            found |= _alignment(scored.position_median_m, alignment(path, errors))
    elif run.topic(f"estimator{STATE}"):
        apart = pose_errors(path, estimated_path(run, "estimator"), max_gap=_MAX_GAP_S)
        distance = np.hypot(*apart.errors[:2])[apart.position_valid]
        found = {"from_ours_median_m": float(np.median(distance))} if distance.size else {}
    else:
        return {}
    return {"robot_localization": found} if found else {}


def wrong_share(run: RunMessages, estimator: str = "estimator") -> float:
    """Return the share of the estimates with a reference that are wrong while the filter says that it is on its track.

    Wrong is farther than ``LOST_M`` from the reference. 0 where there is no reference.
    """
    truth = _truth_of(run, estimator)
    if truth is None or len(run.topic(truth)) < 2 or not run.topic(f"{estimator}{STATE}"):
        return 0.0
    reference, _ = reference_path(run, truth)
    errors = pose_errors(estimated_path(run, estimator), reference, max_gap=_longest_gap(run.topic(truth)))
    wrong = (np.hypot(*errors.errors[:2]) > LOST_M) & tracking(run, estimator)
    return float(np.mean(wrong[errors.position_valid])) if errors.position_valid.any() else 0.0


MEASURES = Measures(
    estimate=Estimate,
    reads=(RobotState, Estimate, PoseInFrame),
    truths=_TRUTHS,
    of_run=_measured,
    of_recording=_with_fit,
    lines=lines_of,
    aligned=aligned,
)
