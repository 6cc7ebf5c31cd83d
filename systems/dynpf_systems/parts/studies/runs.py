"""The rearrangement task for studies: its layouts, the scenario of a run under given conditions, and its measures."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.drive import drive
from dynpf_protocol.messages import Estimate, RobotState
from dynpf_runtime.node import Node, Output, Result, State, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario

from dynpf.rng import generator
from dynpf_systems.parts.config import FilterName, RearrangementConfig, WorkspaceConfig
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.measures import TOPICS, Course, course_of, filter_measures, rearrangement
from dynpf_systems.parts.messages import PartEstimate, PartsEstimate, PartsState
from dynpf_systems.parts.task import NOISE, Noise, PartSpec, RearrangementTask

__all__ = [
    "LAYOUTS",
    "PROCESS",
    "RADII",
    "Conditions",
    "layout_task",
    "measured",
    "parts_scenario",
    "run_parts",
]

SCENARIO = "parts-3-tracked"
"""The scenario of the runs; the study sets task, noise and filter."""

PROCESS = NOISE["low"].process
"""Variance of the robot's motion with noise, m^2 for each tick and coordinate."""
MAX_TICKS = 6000


def _ring(radius: float, count: int, first: float) -> tuple[tuple[float, float], ...]:
    angles = np.radians(first + 360.0 / count * np.arange(count))
    return tuple((radius * math.cos(angle), radius * math.sin(angle)) for angle in angles)


RADII = {3: (0.06, 0.08, 0.11), 6: (0.06, 0.10, 0.08, 0.11, 0.07, 0.09)}

LAYOUTS = {
    "3E": _ring(0.55, 3, 90.0),
    "3I": _ring(0.30, 3, 90.0),
    "3H": ((-0.0844, -0.068), (0.1006, -0.068), (-0.0162, 0.1359)),
    "6E": _ring(0.65, 6, 0.0),
    "6I": _ring(0.40, 6, 0.0),
    "6H": ((-0.215, 0.1075), (-0.01, 0.1075), (0.215, 0.1075), (-0.215, -0.1075), (0.01, -0.1075), (0.215, -0.1075)),
}
"""Goals of three and six parts: easy, intermediate, hard."""


class Conditions(NamedTuple):
    """The conditions of a run.

    ``variance`` (m^2) is that of the measured positions; with 0 neither they nor the motion have noise. ``particles``
    are those of the robot's filter, any positive number for a Kalman filter; with 0 there is no filter.
    """

    variance: float = 0.0
    particles: int = 0
    robot_filter: FilterName = "optimal"
    process_variance: float | None = None  # of the motion; absent: the usual
    controller: RearrangementControllerConfig | None = None
    max_ticks: int = MAX_TICKS

    @property
    def motion_variance(self) -> float:
        """The variance of the motion, m^2 for each tick and coordinate."""
        if self.process_variance is not None:
            return self.process_variance
        return PROCESS if self.variance > 0.0 else 0.0


def layout_task(name: str) -> RearrangementTask:
    """Return the task of a layout, with random starts."""
    goals = LAYOUTS[name]
    parts = zip(RADII[len(goals)], goals, strict=True)
    return RearrangementTask(parts=tuple(PartSpec(radius=radius, goal=goal) for radius, goal in parts))


def parts_scenario(task: RearrangementTask, seed: int, conditions: Conditions) -> Scenario:
    """Return the scenario of a run; without a filter it has no sensors, and ``run_parts`` supplies the estimator."""
    variance, motion = conditions.variance, conditions.motion_variance
    base = _base()
    overhead = msgspec.structs.replace(base.sensors.overhead, variance=variance)
    config = RearrangementConfig(
        filter=conditions.robot_filter,
        n=max(conditions.particles, 1),
        encoder_variance=0.0,
        measurement_variance=variance or None,
        process_variance=motion,
        robot_grey=overhead.robot_grey,
        part_grey=overhead.part_grey,
    )
    sensors = msgspec.structs.replace(base.sensors, overhead=overhead) if conditions.particles else None
    return base.changed(
        seed=seed,
        task=task,
        simulator=WorkspaceConfig(process_variance=motion),
        sensors=sensors,
        estimator=config,
        controller=conditions.controller or RearrangementControllerConfig(),
        max_ticks=conditions.max_ticks,
    )


@lru_cache(maxsize=1)
def _base() -> Scenario:
    return load_scenario(SCENARIO, overrides=["sensors.gripper.theta_std=0.0"])


def run_parts(
    task: RearrangementTask,
    seed: int,
    conditions: Conditions,
    others: dict[str, Node] | None = None,
) -> Course:
    """Run the task to its end and return its course; ``others`` replace the nodes of their names."""
    others = dict(others or {})
    if not conditions.particles:
        others.setdefault("estimator", MeasuredPositions(seed, conditions.variance))
    run = drive(parts_scenario(task, seed, conditions), TOPICS, others=others)
    course = course_of(run, Noise(conditions.motion_variance, conditions.variance))
    assert course is not None
    return course


def measured(course: Course, conditions: Conditions) -> dict[str, Any]:
    """Return the measures of a run under the names of ``dynpf metrics``."""
    return rearrangement(course) | filter_measures(course, conditions.robot_filter)


class MeasuredPositions:
    """An estimator without a filter: measured positions with the measurement's variance."""

    name = "estimator"
    reads = ("truth/robot", "truth/parts")

    def __init__(self, seed: int, variance: float) -> None:
        self._seed, self._variance = seed, variance

    def step(self, step: Step) -> Result:
        """Return estimates that are noisy measurements of the true state."""
        messages = [received.message for received in step.inputs]
        robot = next(message for message in messages if isinstance(message, RobotState))
        parts = next(message for message in messages if isinstance(message, PartsState))
        variance = self._variance
        noise = np.zeros((len(parts.parts) + 1, 2))
        if variance > 0.0:
            noise = generator(self._seed, "sensors", step.tick, "overhead").standard_normal(noise.shape)
            noise *= math.sqrt(variance)
        estimate = Estimate(
            x=robot.x + float(noise[0, 0]),
            y=robot.y + float(noise[0, 1]),
            theta=robot.theta,
            covariance=(variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0),
            n_eff=1.0,
        )
        found = tuple(
            PartEstimate(x=part.x + dx, y=part.y + dy, variance=variance, seen=True)
            for part, (dx, dy) in zip(parts.parts, noise[1:].tolist(), strict=True)
        )
        beside = PartsEstimate(parts=found, held=parts.held)
        return Result((Output("estimator/parts", beside), Output("estimator/state", estimate)))

    def freeze(self) -> State:
        """Return no state: measurements are independent."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""
