"""Measures of the rearrangement task (PARTS): its outcome, and the errors of the estimates of robot and parts."""

import contextlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.measures import Measures
from dynpf_experiments.messages import RunMessages, Timed, of_type
from dynpf_protocol.messages import Estimate, PosesInFrame, RobotState
from numpy.typing import NDArray

from dynpf.metrics import rearrangement as metrics
from dynpf.metrics.consistency import nees
from dynpf.types import FloatArray
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.goals import shared_out
from dynpf_systems.parts.messages import Identities, PartsEstimate, PartsState
from dynpf_systems.parts.task import Noise, RearrangementTask

__all__ = [
    "HOME_TOLERANCE_M",
    "MEASURES",
    "SETTLED_S",
    "SURE",
    "TOPICS",
    "Course",
    "course_of",
    "filter_measures",
    "rearrangement",
]


HOME_TOLERANCE_M = 0.025
"""Greatest distance, in metres, of a part's centre from its goal at which the part is home."""
SETTLED_S = 1.0
"""Time in seconds after its first estimate from which the robot's filter is judged."""
SURE = 0.9999
"""Probability of an identity from which on the estimator counts as sure of it."""

TOPICS = (
    *("truth/robot", "truth/parts"),
    *("estimator/state", "estimator/parts", "estimator/identities", "estimator/particles"),
)
"""Topics from which a course is made."""
_KALMAN = frozenset({"extended_kalman", "unscented_kalman"})


class Course(NamedTuple):
    """The course of a run, tick by tick; metres.

    Over the T ticks of the truth: positions (T, 2) and (T, p, 2) and speeds (T,). Over the E ticks with an estimate,
    whose indices among all ticks are ``known`` (E,): the estimates of the robot (E, 2) with covariances (E, 2, 2) and
    of the parts (E, p, 2), the index of the part estimated to be held, or -1 (E,), and the probabilities of the
    identities of robot and parts (E, p + 1), zero of parts out of view. ``clouds`` are the published particles, (2, M)
    each. ``noise`` is what the filter assumes.
    """

    task: RearrangementTask
    tick_s: float
    noise: Noise
    finished: bool
    contacts: int  # ticks with a contact that is not allowed
    robot: FloatArray
    parts: FloatArray
    speeds: FloatArray
    known: NDArray[np.intp]
    robot_estimate: FloatArray
    covariances: FloatArray
    parts_estimate: FloatArray
    held: NDArray[np.int64]
    identities: FloatArray
    clouds: list[FloatArray]

    @property
    def goals(self) -> FloatArray:
        """The goals of the parts, (p, 2) in metres: of interchangeable ones as they have shared them out at the end."""
        goals = np.array([part.goal for part in self.task.parts])
        return goals[shared_out(self.parts[-1], goals, self.task.kinds)]

    @property
    def radii(self) -> FloatArray:
        """The radii of the parts, (p,) in metres."""
        return np.array([part.radius for part in self.task.parts])

    @property
    def errors(self) -> FloatArray:
        """Errors of the robot's estimated position, (E, 2)."""
        return self.robot_estimate - self.robot[self.known]

    @property
    def information(self) -> FloatArray:
        """Information, (E,) in 1/m^2, of each tick's readings about the robot: of its disc and a held part."""
        sights: FloatArray = 1.0 + (self.held >= 0).astype(np.float64)
        return sights / self.noise.measurement

    @property
    def swapped(self) -> NDArray[np.bool_]:
        """Whether a tick with an estimate has an identity taken for sure that is another's, (E,).

        That is robot or part whose estimate lies nearer to the truth of one that is not interchangeable with it.
        """
        if not len(self.parts_estimate):
            return np.zeros(len(self.known), dtype=bool)
        truths = np.concatenate([self.robot[self.known, None], self.parts[self.known]], axis=1)
        found = np.concatenate([self.robot_estimate[:, None], self.parts_estimate], axis=1)
        kinds = np.append(-1, self.task.kinds)
        distance = np.linalg.norm(found[:, :, None] - truths[:, None], axis=3)
        wrong = kinds[distance.argmin(axis=2)] != kinds
        return np.asarray(np.any(wrong & (self.identities >= SURE), axis=1))

    @property
    def settled(self) -> slice:
        """The slice of the estimates by which the robot's filter is judged."""
        return slice(round(SETTLED_S / self.tick_s), None)


def course_of(run: RunMessages, noise: Noise | None = None) -> Course | None:
    """Return the course of a run, None for a run without the task; ``noise`` overrides that of the run's estimator."""
    truth, parts_truth = run.topic("truth/robot"), run.topic("truth/parts")
    if not parts_truth or len(parts_truth) != len(truth):
        return None
    task, config = run.scenario.task, run.scenario.estimator
    robots, states = of_type(truth, RobotState), of_type(parts_truth, PartsState)
    if task is None or any(len(state.parts) != len(task.parts) for state in states):
        return None
    if noise is None:
        noise = config.noise(task) if isinstance(config, RearrangementConfig) else Noise(math.nan, math.nan)
    ticks = {timed.stamp_ns: tick for tick, timed in enumerate(truth)}
    estimated = [timed for timed in run.topic("estimator/state") if timed.stamp_ns in ticks]
    estimates = of_type(estimated, Estimate)
    beside = {timed.stamp_ns: timed for timed in run.topic("estimator/parts")}
    found = of_type([beside[timed.stamp_ns] for timed in estimated if timed.stamp_ns in beside], PartsEstimate)
    complete = len(found) == len(estimates) and all(len(message.parts) == len(task.parts) for message in found)
    said = {timed.stamp_ns: timed for timed in run.topic("estimator/identities")}
    certain = [1.0] * (len(task.parts) + 1)
    clouds = of_type(run.topic("estimator/particles"), PosesInFrame)
    return Course(
        task=task,
        tick_s=run.scenario.tick_s,
        noise=noise,
        finished=states[-1].finished,
        contacts=states[-1].contacts,
        robot=np.array([(state.x, state.y) for state in robots]),
        parts=np.array([[(part.x, part.y) for part in state.parts] for state in states]),
        speeds=np.array([state.v for state in robots]),
        known=np.array([ticks[timed.stamp_ns] for timed in estimated], dtype=np.intp),
        robot_estimate=np.array([(estimate.x, estimate.y) for estimate in estimates]).reshape(-1, 2),
        covariances=np.array([estimate.covariance for estimate in estimates]).reshape(-1, 3, 3)[:, :2, :2],
        parts_estimate=np.array([[(part.x, part.y) for part in message.parts] for message in found if complete]),
        held=np.array([message.held for message in found] if complete else [-1] * len(estimates), dtype=np.int64),
        identities=np.array(
            [_probabilities(said[timed.stamp_ns]) if timed.stamp_ns in said else certain for timed in estimated]
        ).reshape(-1, len(certain))
        * _in_view(found if complete else [], (len(estimates), len(certain))),
        clouds=[np.array([(pose.position.x, pose.position.y) for pose in cloud.poses]).T for cloud in clouds],
    )


def _probabilities(timed: Timed) -> list[float]:
    (message,) = of_type([timed], Identities)
    return [message.robot, *message.parts]


def _in_view(found: list[PartsEstimate], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return whether robot and parts are seen, (E, p + 1); the robot counts as seen."""
    seen = np.ones(shape, dtype=bool)
    if found:
        seen[:, 1:] = [[part.seen for part in message.parts] for message in found]
    return seen


def rearrangement(course: Course) -> dict[str, Any]:
    """Return the measures of the task; measures without data in the run are left out.

    - ``completed``: whether at the end every part is home, within ``HOME_TOLERANCE_M`` of its goal, or of that of a
      part with which it is interchangeable
    - ``finished``: whether the controller said so
    - ``swaps_unnoticed``: ticks in which the estimator took one for another and was sure of it
    - ``collisions``: ticks with a contact that is not allowed
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
        "finished": course.finished,
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
        measures["swaps_unnoticed"] = int(course.swapped.sum())
        measures["ppee_m"] = metrics.part_position_error(course.parts[course.known], course.parts_estimate)
    return measures


def filter_measures(course: Course, filter_name: str = "") -> dict[str, float]:
    """Return the measures of the robot's filter; measures without data in the run are left out.

    - ``snr_db``: see ``signal_to_noise_db``, for the measurement noise that the filter assumes
    - ``kurtosis``: see the function of that name; mean over the published clouds of a particle filter
    - ``crlb_ratio``: root mean square error of the robot's position over that of its Cramer-Rao bound, once the filter
      has settled. The bound assumes that all discs are in view at every tick
    - ``robot_nees``: normalized estimation error squared of the robot's position, mean over the same ticks; ideally 2
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
        if measures["finished"] != measures["completed"]:
            lines.append(f"controller  {'' if measures['finished'] else 'NOT '}finished, as it says itself")
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
