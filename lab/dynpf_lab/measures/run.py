"""Measures of one recorded run against the truth in it, under the names that scripts hold on to."""

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recorded, Recording
from dynpf_protocol.codec import decode
from dynpf_protocol.messages import (
    CapsuleEstimate,
    CapsuleState,
    Estimate,
    PartsState,
    PoseInFrame,
    PosesInFrame,
    RobotState,
    heading,
)
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import override_resolved
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.schema import Scenario
from dynpf_systems.colon.tube import colon_world
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.task import RearrangementTask
from numpy.typing import NDArray

from dynpf.maps.raycast import RayCaster
from dynpf.metrics import rearrangement
from dynpf.metrics.colon import capsule_errors, first_visible, map_errors
from dynpf.metrics.consistency import mean_square, nees
from dynpf.metrics.trajectory import Trajectory, pose_errors, score, thin

__all__ = ["HOME_TOLERANCE_M", "LOST_M", "differing", "measure", "summary"]

FloatArray = NDArray[np.float64]

HOME_TOLERANCE_M = 0.025
"""A part counts as home when its centre is this near to its goal."""

LOST_M = 1.0
"""The robot counts as lost while the estimate is farther than this from the truth."""

_SCORED_HZ = 10.0
_MAX_GAP_S = 0.5
_AXES = ("x", "y", "theta")
_TRUTHS = ("truth/robot", "log/truth")


def measure(recording: Recording) -> dict[str, Any]:
    """Return the measures of a run; those that it holds no data for are left out."""
    return {**_figures(recording), "content_digest": content_digest(recording)}


def differing(a: Recording, b: Recording) -> dict[str, tuple[Any, Any]]:
    """Return the measures, without the digest, in which two runs differ: both values, None where a run lacks one."""
    left, right = _figures(a), _figures(b)
    names = [*left, *(name for name in right if name not in left)]
    return {name: (left.get(name), right.get(name)) for name in names if left.get(name) != right.get(name)}


def _figures(recording: Recording) -> dict[str, Any]:
    end = recording.end
    measures: dict[str, Any] = {}
    measures |= _localization(recording)
    measures |= _rearrangement(recording)
    measures |= _capsule(recording)
    measures["messages"] = sum(1 for _ in recording.messages())
    measures["gaps"] = end.missing if end is not None else None
    measures["complete"] = end is not None and end.complete and not recording.truncated
    return measures


def summary(recording: Recording, measures: Mapping[str, Any]) -> str:
    """Return the measures as a person reads them."""
    scenario = _scenario(recording)
    state = "complete" if measures["complete"] else "INCOMPLETE"
    reason = recording.end.reason if recording.end is not None else "it was never closed"
    lines = [f"{scenario.title} (seed {scenario.seed})", f"recording   {recording.path}, {state}: {reason}"]
    topic = "estimator/capsule" if "error_position_px" in measures else "estimator/state"
    stamps = [record.stamp_ns for record in recording.messages(topic)]
    if stamps:
        lines.append(f"duration    {(max(stamps) - min(stamps)) * 1e-9:.1f} s of logical time, {len(stamps)} estimates")
    lines.append(f"messages    {measures['messages']}, {measures['gaps']} missing")
    if "completed" in measures:
        home = "all parts home" if measures["completed"] else "NOT all parts home"
        error_cm = 100.0 * _final_error_m(recording)
        lines.append(f"task        {home}, {measures['collisions']} collisions, final error {error_cm:.2f} cm")
        lines.append(f"paths       npl {measures['npl']:.3f}, nrl {measures['nrl']:.3f} (1 = straight lines)")
    if "crlb_ratio" in measures:
        lines.append(f"bound       robot's RMS error {measures['crlb_ratio']:.2f} times the Cramer-Rao bound")
    if "position_rmse_m" in measures:
        text = f"position    RMSE {measures['position_rmse_m']:.4f} m, median {measures['position_median_m']:.4f} m"
        if "dead_reckoning_rmse_m" in measures:
            text += f"; odometry alone {measures['dead_reckoning_rmse_m']:.3f} m"
        lines.append(text)
    if "heading_rmse_rad" in measures:
        lines.append(f"heading     RMSE {np.degrees(measures['heading_rmse_rad']):.2f} deg")
    if "error_position_px" in measures:
        lines += _capsule_summary(measures)
    lines.append(f"digest      {measures['content_digest']}")
    return "\n".join(lines)


def _scenario(recording: Recording) -> Scenario:
    return override_resolved(recording.header.scenario, (), str(recording.path))


def _localization(recording: Recording) -> dict[str, Any]:
    truth = next((name for name in _TRUTHS if any(True for _ in recording.messages(name))), None)
    if truth is None:
        return {}
    stamps, states = _read(recording, truth, RobotState)
    estimated_at, estimates = _read(recording, "estimator/state", Estimate)
    if len(states) < 2 or not estimates:
        return {}
    reference = Trajectory(stamps, np.array([(one.x, one.y, one.theta) for one in states]).T)
    valid = np.array([one.heading_valid for one in states])
    chosen, max_gap = _scored(recording, "estimator/state", truth)
    poses = np.array([(one.x, one.y, one.theta) for one in estimates]).T[:, chosen]
    estimate = Trajectory(estimated_at[chosen], poses)
    scored = score(estimate, reference, heading_valid=valid, max_gap=max_gap)
    errors = pose_errors(estimate, reference, heading_valid=valid, max_gap=max_gap)
    distance = np.hypot(*errors.errors[:2])[errors.position_valid]
    measures: dict[str, Any] = {
        "position_rmse_m": scored.position_rmse_m,
        "position_median_m": scored.position_median_m,
        "position_p95_m": scored.position_p95_m,
        "heading_rmse_rad": scored.heading_rmse_rad,
        "lost_fraction": float(np.mean(distance > LOST_M)) if distance.size else np.nan,
    }
    if verdicts := [one.health.status for one in estimates if one.health]:
        measures["lost_by_verdict"] = verdicts.count("lost") / len(verdicts)
    measures |= _consistency(errors.errors, errors.heading_valid, [estimates[place] for place in chosen])
    measures |= _dead_reckoning(recording, reference, truth)
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def _scored(recording: Recording, topic: str, truth: str) -> tuple[NDArray[np.intp], float]:
    """Return the indices of the estimates, by time, that are scored, and the longest gap of the truth to interpolate.

    A truth that is too sparse for that, such as one pose a scan, is compared at its own poses: each with the first
    estimate of its stamp that follows it.
    """
    records = _by_time(recording, topic)
    stamps, known = (np.array([one.stamp_ns * 1e-9 for one in some]) for some in (records, _by_time(recording, truth)))
    if np.median(np.diff(known)) <= _MAX_GAP_S:
        return thin(stamps, _SCORED_HZ), _MAX_GAP_S
    chosen: set[Recorded] = set()
    due_ns: int | None = None
    for record in recording.messages():
        if record.topic == truth:
            due_ns = record.stamp_ns
        elif record.topic == topic and record.stamp_ns == due_ns:
            chosen.add(record)
            due_ns = None
    return np.flatnonzero([one in chosen for one in records]), np.inf


def _consistency(errors: FloatArray, valid: NDArray[np.bool_], estimates: list[Estimate]) -> dict[str, float]:
    covariances = np.array([one.covariance for one in estimates]).reshape(-1, 3, 3)
    # A heading that is measured rather than estimated has no variance: the position alone is then judged.
    dimension = 3 if np.all(covariances[:, 2, 2] > 0.0) else 2
    values = nees(errors[:dimension, valid], covariances[valid][:, :dimension, :dimension])
    if np.isnan(values).all():
        return {}
    judged = mean_square(values, dimension)
    return {"nees_mean": judged.figure, "nees_low": judged.low, "nees_high": judged.high}


def _dead_reckoning(recording: Recording, reference: Trajectory, truth: str) -> dict[str, float]:
    stamps, poses = _read(recording, "estimator/dead_reckoning", PoseInFrame)
    if not poses:
        return {}
    chosen, max_gap = _scored(recording, "estimator/dead_reckoning", truth)
    places = [poses[place].pose for place in chosen]
    path = np.array([(one.position.x, one.position.y, heading(one.orientation)) for one in places]).T
    return {
        "dead_reckoning_rmse_m": score(Trajectory(stamps[chosen], path), reference, max_gap=max_gap).position_rmse_m
    }


def _rearrangement(recording: Recording) -> dict[str, Any]:
    _, states = _read(recording, "truth/parts", PartsState)
    _, robots = _read(recording, "truth/robot", RobotState)
    if not states or len(states) != len(robots):
        return {}
    task = _scenario(recording).task
    if task is None:
        return {}
    parts = np.array([[(part.x, part.y) for part in state.parts] for state in states])
    goals = np.array([part.goal for part in task.parts])
    radii = np.array([part.radius for part in task.parts])
    robot = np.array([(one.x, one.y) for one in robots])
    measures: dict[str, Any] = {
        "completed": rearrangement.all_home(parts[-1], goals, HOME_TOLERANCE_M),
        "collisions": states[-1].contacts,
        "npl": rearrangement.normalized_part_length(parts, goals),
        "nrl": rearrangement.normalized_robot_length(robot, parts, goals, radii, task.robot_radius),
        "pi": rearrangement.positional_inaccuracy(parts[-1], goals, radii),
    }
    with contextlib.suppress(ValueError):  # goals that overlap have none
        measures["comp"] = rearrangement.packing_density(goals, radii)
    _, estimates = _read(recording, "estimator/state", Estimate)
    if len(estimates) == len(robots) and all(len(one.parts) == len(task.parts) for one in estimates):
        estimated = np.array([(one.x, one.y) for one in estimates])
        placed = np.array([[(part.x, part.y) for part in one.parts] for one in estimates])
        measures["rpee_m"] = rearrangement.robot_position_error(robot, estimated)
        measures["ppee_m"] = rearrangement.part_position_error(parts, placed)
    return measures | _filter_figures(recording, task, robots, estimates)


def _filter_figures(
    recording: Recording, task: RearrangementTask, robots: list[RobotState], estimates: list[Estimate]
) -> dict[str, float]:
    """Return what is said of the robot's filter: signal to noise, kurtosis of its particles, error against the bound.

    The bound takes the noise to be what the filter expects, and every disc that counts to be in view at every tick; the
    error is compared from the second second on, where each tick of the truth has its estimate.
    """
    scenario = _scenario(recording)
    if not isinstance(scenario.estimator, RearrangementConfig) or not estimates:
        return {}
    noise = scenario.estimator.noise(task)
    speeds = np.array([one.v for one in robots])
    measures = {"snr_db": rearrangement.signal_to_noise_db(speeds, noise.measurement)}
    _, clouds = _read(recording, "estimator/particles", PosesInFrame)
    shapes = [
        rearrangement.kurtosis(np.array([(pose.position.x, pose.position.y) for pose in cloud.poses]).T)
        for cloud in clouds
    ]
    if shapes and scenario.estimator.filter not in {"extended_kalman", "unscented_kalman"}:
        measures["kurtosis"] = float(np.nanmean(shapes)) if not np.isnan(shapes).all() else np.nan
    settled = round(1.0 / scenario.tick_s)
    late = len(robots) - len(estimates)
    if settled < len(estimates) and 0 <= late < settled:
        held = np.array([one.held >= 0 for one in estimates])
        information = (1.0 + held) / noise.measurement
        bounds = rearrangement.robot_bound(information, noise.process).noisy
        truth = np.array([(one.x, one.y) for one in robots[late:]])
        errors = np.linalg.norm(np.array([(one.x, one.y) for one in estimates]) - truth, axis=1)
        measures["crlb_ratio"] = rearrangement.bound_ratio(errors[settled:], bounds[settled:])
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def _capsule(recording: Recording) -> dict[str, Any]:
    """Return the measures of COLON: of the pose at the last estimate, and of the posterior over maps up to there."""
    _, states = _read(recording, "truth/capsule", CapsuleState)
    _, estimates = _read(recording, "estimator/capsule", CapsuleEstimate)
    by_reading = {one.reading: one for one in states}
    followed = [(by_reading[one.reading], one) for one in estimates if one.reading in by_reading]
    if not followed:
        return {}
    true = np.array([(one.x_px, one.y_px, one.theta) for one, _ in followed]).T
    last = followed[-1][1]
    measures: dict[str, Any] = capsule_errors(true[:, -1], np.array([last.x_px, last.y_px, last.theta]))
    held = [one.map for one, _ in followed]
    if last.maps:
        posteriors = [{one.map: one.probability for one in estimate.maps} for _, estimate in followed]
        measures |= map_errors(held, posteriors, first_visible(held, true, _capsule_casters(recording)))
    if isinstance(last.end_radius_px, float) and held[-1].startswith("end "):
        radius = float(held[-1].removeprefix("end "))
        measures["error_radius_percent"] = 100.0 * abs(last.end_radius_px - radius) / radius
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def _capsule_casters(recording: Recording) -> Callable[[str], RayCaster]:
    world = colon_world(Context(recorded_scenario(recording), ""))
    casters = {name: RayCaster(grid) for name, grid in world.true_grids().items()}
    return casters.__getitem__


def _capsule_summary(measures: Mapping[str, Any]) -> list[str]:
    shares = [f"{measures[f'error_{name}_percent']:.3f}" for name in _AXES if f"error_{name}_percent" in measures]
    lost = ", LOST" if measures["lost"] else ""
    lines = [
        f"final pose  {measures['error_position_px']:.2f} px and {measures['error_theta_rad']:.4f} rad off{lost};"
        f" {' / '.join(shares)} % of x, y, theta"
    ]
    if "posterior_truth" in measures:
        text = f"map         probability of the true one at the end {measures['posterior_truth']:.3f}"
        if "delay_steps" in measures:
            text += f", change reported {measures['delay_steps']:.0f} readings after it could be seen"
        if measures.get("missed"):
            text += ", change NOT reported"
        if measures.get("false_alarm"):
            text += ", change reported that there was NOT"
        lines.append(text)
    if "error_radius_percent" in measures:
        lines.append(f"end radius  {measures['error_radius_percent']:.2f} % off")
    return lines


def _final_error_m(recording: Recording) -> float:
    """Return how far from its goal the part ended that ended farthest."""
    _, states = _read(recording, "truth/parts", PartsState)
    return max(math.hypot(part.x - part.goal_x, part.y - part.goal_y) for part in states[-1].parts)


def _read(recording: Recording, topic: str, kind: type[Any]) -> tuple[FloatArray, list[Any]]:
    """Return stamps in seconds and messages of a topic in order of time."""
    records = _by_time(recording, topic)
    messages = [decode(topic, record.payload) for record in records]
    assert all(isinstance(message, kind) for message in messages)
    return np.array([record.stamp_ns * 1e-9 for record in records]), messages


def _by_time(recording: Recording, topic: str) -> list[Recorded]:
    return sorted(recording.messages(topic), key=lambda record: record.stamp_ns)
