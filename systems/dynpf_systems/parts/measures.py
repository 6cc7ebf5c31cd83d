"""Measures of the rearrangement task (PARTS): what became of the parts, and how well robot and parts were known."""

import contextlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.measures import Measures
from dynpf_experiments.messages import RunMessages, of_type
from dynpf_protocol.messages import Estimate, PosesInFrame, RobotState
from numpy.typing import NDArray

from dynpf.metrics import rearrangement as metrics
from dynpf.metrics.consistency import nees
from dynpf.types import FloatArray
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.messages import PartsEstimate, PartsState
from dynpf_systems.parts.task import Noise, RearrangementTask

__all__ = [
    "HOME_TOLERANCE_M",
    "MEASURES",
    "SETTLED_S",
    "TOPICS",
    "Course",
    "course_of",
    "filter_measures",
    "rearrangement",
]


HOME_TOLERANCE_M = 0.025
"""A part is home when its centre is this near to its goal, in metres."""
SETTLED_S = 1.0
"""The robot's filter is judged from so many seconds after its first estimate on."""

TOPICS = ("truth/robot", "truth/parts", "estimator/state", "estimator/parts", "estimator/particles")
"""Of the messages that a course is made of."""
_KALMAN = frozenset({"extended_kalman", "unscented_kalman"})


class Course(NamedTuple):
    """What happened in a run, tick by tick; metres.

    Over the T ticks of the truth: positions (T, 2) and (T, p, 2) and speeds (T,). Over the E ticks that have an
    estimate, whose indices among all are ``known`` (E,): the estimate of the robot (E, 2) with its covariances
    (E, 2, 2) and of the parts (E, p, 2), and the part thought to be held, or -1 (E,). ``clouds`` are the particles that
    were published, (2, M) each. ``noise`` is what the filter expects.
    """

    task: RearrangementTask
    tick_s: float
    noise: Noise
    finished: bool
    contacts: int  # ticks in which something touched what it should not
    robot: FloatArray
    parts: FloatArray
    speeds: FloatArray
    known: NDArray[np.intp]
    robot_estimate: FloatArray
    covariances: FloatArray
    parts_estimate: FloatArray
    held: NDArray[np.int64]
    clouds: list[FloatArray]

    @property
    def goals(self) -> FloatArray:
        return np.array([part.goal for part in self.task.parts])

    @property
    def radii(self) -> FloatArray:
        return np.array([part.radius for part in self.task.parts])

    @property
    def errors(self) -> FloatArray:
        """Where the robot was thought to be against where it was, (E, 2)."""
        return self.robot_estimate - self.robot[self.known]

    @property
    def information(self) -> FloatArray:
        """What the readings of each tick tell of a coordinate of the robot, (E,): of its disc and of what it holds."""
        sights: FloatArray = 1.0 + (self.held >= 0).astype(np.float64)
        return sights / self.noise.measurement

    @property
    def settled(self) -> slice:
        """The estimates by which the robot's filter is judged."""
        return slice(round(SETTLED_S / self.tick_s), None)


def course_of(run: RunMessages, noise: Noise | None = None) -> Course | None:
    """Return the course of a run of the task, None of another run; ``noise`` if not that of the run's estimator."""
    truth, placed = run.topic("truth/robot"), run.topic("truth/parts")
    if not placed or len(placed) != len(truth):
        return None
    task, config = run.scenario.task, run.scenario.estimator
    if task is None:
        return None
    if noise is None:
        noise = config.noise(task) if isinstance(config, RearrangementConfig) else Noise(math.nan, math.nan)
    robots, states = of_type(truth, RobotState), of_type(placed, PartsState)
    ticks = {timed.stamp_ns: tick for tick, timed in enumerate(truth)}
    thought = [timed for timed in run.topic("estimator/state") if timed.stamp_ns in ticks]
    estimates = of_type(thought, Estimate)
    beside = {timed.stamp_ns: timed for timed in run.topic("estimator/parts")}
    found = of_type([beside[timed.stamp_ns] for timed in thought if timed.stamp_ns in beside], PartsEstimate)
    complete = len(found) == len(estimates) and all(len(one.parts) == len(task.parts) for one in found)
    clouds = of_type(run.topic("estimator/particles"), PosesInFrame)
    return Course(
        task=task,
        tick_s=run.scenario.tick_s,
        noise=noise,
        finished=states[-1].finished,
        contacts=states[-1].contacts,
        robot=np.array([(one.x, one.y) for one in robots]),
        parts=np.array([[(part.x, part.y) for part in one.parts] for one in states]),
        speeds=np.array([one.v for one in robots]),
        known=np.array([ticks[timed.stamp_ns] for timed in thought], dtype=np.intp),
        robot_estimate=np.array([(one.x, one.y) for one in estimates]).reshape(-1, 2),
        covariances=np.array([one.covariance for one in estimates]).reshape(-1, 3, 3)[:, :2, :2],
        parts_estimate=np.array([[(part.x, part.y) for part in one.parts] for one in found if complete]),
        held=np.array([one.held for one in found] if complete else [-1] * len(estimates), dtype=np.int64),
        clouds=[np.array([(pose.position.x, pose.position.y) for pose in one.poses]).T for one in clouds],
    )


def rearrangement(course: Course) -> dict[str, Any]:
    """Return the measures of the task; those that the run holds no data for are left out.

    - ``completed``: whether at the end every part is home, within ``HOME_TOLERANCE_M`` of its goal
    - ``collisions``: ticks in which something touched what it should not
    - ``npl``, ``nrl``, ``pi``: see ``normalized_part_length``, ``normalized_robot_length``, ``positional_inaccuracy``
    - ``final_error_mean_m``, ``final_error_max_m``: distance of a part from its goal at the end, m: mean over the
      parts, and that of the farthest
    - ``comp``: see ``packing_density``; goals that overlap have none
    - ``rpee_m``, ``ppee_m``: see ``robot_position_error`` and ``part_position_error``, over the ticks with an estimate
    """
    final, goals, radii = course.parts[-1], course.goals, course.radii
    distances = np.linalg.norm(final - goals, axis=1)
    measures: dict[str, Any] = {
        "completed": metrics.all_home(final, goals, HOME_TOLERANCE_M),
        "collisions": course.contacts,
        "npl": metrics.normalized_part_length(course.parts, goals),
        "nrl": metrics.normalized_robot_length(course.robot, course.parts, goals, radii, course.task.robot_radius),
        "pi": metrics.positional_inaccuracy(final, goals, radii),
        "final_error_mean_m": float(distances.mean()),
        "final_error_max_m": float(distances.max()),
    }
    with contextlib.suppress(ValueError):  # goals that overlap have none
        measures["comp"] = metrics.packing_density(goals, radii)
    if len(course.parts_estimate):
        measures["rpee_m"] = metrics.robot_position_error(course.robot[course.known], course.robot_estimate)
        measures["ppee_m"] = metrics.part_position_error(course.parts[course.known], course.parts_estimate)
    return measures


def filter_measures(course: Course, filter_name: str = "") -> dict[str, float]:
    """Return what is said of the robot's filter; what cannot be told is left out.

    - ``snr_db``: see ``signal_to_noise_db``, by the measurement noise that the filter expects
    - ``kurtosis``: see there; mean over the clouds that were published, of a filter that has particles
    - ``crlb_ratio``: root mean square error of the robot's position over that of its Cramer-Rao bound, once the filter
      has settled. The bound takes every disc that counts to be in view at every tick
    - ``robot_nees``: normalized estimation error squared of the robot's position, mean over the same ticks; 2 is honest
    """
    if not len(course.known) or not course.noise.measurement > 0.0:
        return {}
    measures = {"snr_db": metrics.signal_to_noise_db(course.speeds, course.noise.measurement)}
    shapes = [metrics.kurtosis(cloud) for cloud in course.clouds]
    if shapes and filter_name not in _KALMAN:
        measures["kurtosis"] = float(np.nanmean(shapes)) if not np.isnan(shapes).all() else np.nan
    without_gap = bool((np.diff(course.known) == 1).all())
    settled = course.settled
    if settled.start < len(course.known) and course.known[0] < settled.start and without_gap:
        bounds = metrics.robot_bound(course.information, course.noise.process).noisy
        errors = course.errors[settled]
        measures["crlb_ratio"] = metrics.bound_ratio(np.linalg.norm(errors, axis=1), bounds[settled])
        measures["robot_nees"] = float(np.mean(nees(errors.T, course.covariances[settled])))
    return {name: value for name, value in measures.items() if np.isfinite(value)}


def _measured(run: RunMessages) -> dict[str, Any]:
    course = course_of(run)
    if course is None:
        return {}
    config = run.scenario.estimator
    of_filter = filter_measures(course, config.filter) if isinstance(config, RearrangementConfig) else {}
    return rearrangement(course) | of_filter


def _lines(measures: Mapping[str, Any]) -> list[str]:
    lines = []
    if "completed" in measures:
        home = "all parts home" if measures["completed"] else "NOT all parts home"
        error_cm = 100.0 * measures["final_error_max_m"]
        collisions = measures["collisions"]
        lines.append(f"task        {home}, {collisions} collisions, farthest part {error_cm:.2f} cm from its goal")
        lines.append(f"paths       npl {measures['npl']:.3f}, nrl {measures['nrl']:.3f} (1 = straight lines)")
    if "crlb_ratio" in measures:
        lines.append(f"bound       robot's RMS error {measures['crlb_ratio']:.2f} times the Cramer-Rao bound")
    return lines


MEASURES = Measures(
    estimate=Estimate,
    reads=(RobotState, PartsState, Estimate, PosesInFrame),
    truths=("truth/robot",),
    of_run=_measured,
    lines=_lines,
)
