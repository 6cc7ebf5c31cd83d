"""The rearrangement task for studies: its layouts, the scenario of a run under some conditions, and its measures."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from dynpf_protocol.messages import Estimate, PartEstimate, PartsState, RobotState
from dynpf_runtime.node import Node, Output, Result, State, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from dynpf_services.sensors.simulated import SimulatedSensorsConfig
from dynpf_systems.parts.config import FilterName, RearrangementConfig, WorkspaceConfig
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.sensors import GripperSensor, OverheadSensor
from dynpf_systems.parts.task import NOISE as LEVELS
from dynpf_systems.parts.task import Noise, PartSpec, RearrangementTask

from dynpf.rng import generator
from dynpf_lab.measures.rearrangement import TOPICS, Course, course_of, filter_measures, rearrangement
from dynpf_lab.studies.drive import drive

__all__ = [
    "LAYOUTS",
    "NOISE",
    "PROCESS",
    "RADII",
    "Conditions",
    "layout_task",
    "measured",
    "parts_scenario",
    "run_parts",
]

SCENARIO = "parts-3-tracked"
"""What the runs are made of; task, noise and filter are the study's."""

NOISE = {level: noise.measurement for level, noise in LEVELS.items()}
"""Measurement variance in m^2 (PARTS chapter 4)."""
PROCESS = LEVELS["low"].process
"""Variance of the robot's motion, m^2 a tick and coordinate, where there is noise."""
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
    """Under what a task is done.

    ``variance`` (m^2) is that of the measured positions; 0: they are true, and so is the motion. ``particles``: those
    of the robot's filter, which for a Kalman filter may be any number; 0: measured positions are used as they come.
    """

    variance: float = 0.0
    particles: int = 0
    robot_filter: FilterName = "optimal"
    process_variance: float | None = None  # of the motion, if it is to be another than the usual
    controller: RearrangementControllerConfig | None = None
    max_ticks: int = MAX_TICKS

    @property
    def motion_variance(self) -> float:
        if self.process_variance is not None:
            return self.process_variance
        return PROCESS if self.variance > 0.0 else 0.0


def layout_task(name: str) -> RearrangementTask:
    """Return the task of a layout, with starts that the seed draws."""
    goals = LAYOUTS[name]
    parts = zip(RADII[len(goals)], goals, strict=True)
    return RearrangementTask(parts=tuple(PartSpec(radius=radius, goal=goal) for radius, goal in parts))


def parts_scenario(task: RearrangementTask, seed: int, conditions: Conditions) -> Scenario:
    """Return the scenario of a run; without a filter it has no sensors, and ``run_parts`` gives it its estimator."""
    variance, motion = conditions.variance, conditions.motion_variance
    overhead = OverheadSensor(variance=variance)
    config = RearrangementConfig(
        filter=conditions.robot_filter,
        n=max(conditions.particles, 1),
        encoder_variance=0.0,
        measurement_variance=variance or None,
        process_variance=motion,
        robot_grey=overhead.robot_grey,
        part_grey=overhead.part_grey,
    )
    sensors = SimulatedSensorsConfig(gripper=GripperSensor(), overhead=overhead) if conditions.particles else None
    return _base().changed(
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
    return load_scenario(SCENARIO)


def run_parts(
    task: RearrangementTask,
    seed: int,
    conditions: Conditions,
    others: dict[str, Node] | None = None,
) -> Course:
    """Run the task to its end and return its course; ``others`` take the place of the nodes of their names."""
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
    """An estimator without a filter: positions as measured, with the measurement's variance."""

    name = "estimator"
    reads = ("truth/robot", "truth/parts")

    def __init__(self, seed: int, variance: float) -> None:
        self._seed, self._variance = seed, variance

    def step(self, step: Step) -> Result:
        """Answer each true state with what is measured of it."""
        messages = [one.message for one in step.inputs]
        robot = next(one for one in messages if isinstance(one, RobotState))
        parts = next(one for one in messages if isinstance(one, PartsState))
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
            held=parts.held,
            parts=tuple(
                PartEstimate(x=part.x + dx, y=part.y + dy, variance=variance, seen=True)
                for part, (dx, dy) in zip(parts.parts, noise[1:].tolist(), strict=True)
            ),
        )
        return Result((Output("estimator/state", estimate),))

    def freeze(self) -> State:
        """Return nothing: each measurement is for itself."""
        return {}

    def thaw(self, state: State) -> None:
        """There is no state."""
