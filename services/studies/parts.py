"""Runs of the rearrangement task for studies: layouts, one run without a bus, and its measures; pure and seeded."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.metrics.rearrangement import (
    all_home,
    normalized_part_length,
    normalized_robot_length,
    part_position_error,
    positional_inaccuracy,
    robot_position_error,
)
from dynpf.rng import generator
from protocol.messages import Detections, Estimate, Gripper, Message, PartEstimate, PartsState, RobotState
from services.controller.config import RearrangementControllerConfig
from services.controller.rearrangement import RearrangementController
from services.estimator.config import RearrangementConfig
from services.estimator.rearrangement import RearrangementEstimator
from services.node import Received, Step
from services.sensors.config import GripperSensor, OverheadSensor, SimulatedSensorsConfig
from services.sensors.simulated import SimulatedSensors
from services.simulator.config import WorkspaceConfig
from services.simulator.workspace import WorkspaceSimulator
from services.task import PartSpec, RearrangementTask

__all__ = ["LAYOUTS", "NOISE", "PartsRun", "layout_task", "run_parts"]

FloatArray = NDArray[np.float64]
Inputs = tuple[tuple[str, Message], ...]

TICK_S, TICK_NS = 0.05, 50_000_000
HOME = 0.05  # metres from the goal within which a part counts as home at the end of a study's run

NOISE = {"none": 0.0, "low": 0.2e-4, "medium": 1.0e-4, "high": 5.0e-4}
"""Measurement variance in m^2 (PARTS chapter 4)."""


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


class PartsRun(NamedTuple):
    """The measures of one run; lengths in metres."""

    completed: bool  # finished, and every part is home
    collided: bool
    npl: float
    nrl: float
    pi: float
    final_error: float  # mean over parts
    rpee: float
    ppee: float
    ticks: int


def layout_task(name: str) -> RearrangementTask:
    """Return the task of a layout, with starts that the seed draws."""
    goals = LAYOUTS[name]
    parts = zip(RADII[len(goals)], goals, strict=True)
    return RearrangementTask(parts=tuple(PartSpec(radius=radius, goal=goal) for radius, goal in parts))


def run_parts(
    task: RearrangementTask,
    seed: int,
    *,
    variance: float = 0.0,
    particles: int = 0,
    process_variance: float | None = None,
    controller: RearrangementControllerConfig | None = None,
    max_ticks: int = 6000,
    watch: Callable[[RearrangementController, Estimate], None] | None = None,
) -> PartsRun:
    """Run the loop of simulator, sensors, estimator and controller to its end.

    ``variance`` (m^2) is that of the measured positions; 0: they are true, and so is the motion. ``particles``: those
    of the robot's filter; 0: measured positions are used as they come. ``watch`` is shown each tick's estimate first.
    """
    motion = (0.06e-4 if variance > 0.0 else 0.0) if process_variance is None else process_variance
    workspace = WorkspaceConfig(process_variance=motion)
    simulator = WorkspaceSimulator(config=workspace, seed=seed, tick_s=TICK_S, task=task)
    estimates = _Filtered(task, seed, variance, motion, particles) if particles else _Measured(seed, variance)
    config = RearrangementControllerConfig() if controller is None else controller
    node = RearrangementController(config=config, seed=seed, tick_s=TICK_S, task=task)
    truth: list[tuple[FloatArray, FloatArray]] = []
    believed: list[tuple[FloatArray, FloatArray]] = []
    command: Inputs = ()
    last: PartsState | None = None
    for tick in range(max_ticks):
        result = simulator.step(_step(tick, command))
        robot, parts = (output.message for output in result.outputs[:2])
        assert isinstance(robot, RobotState)
        assert isinstance(parts, PartsState)
        last = parts
        truth.append((np.array([robot.x, robot.y]), np.array([(part.x, part.y) for part in parts.parts])))
        estimate = estimates.step(tick, robot, parts, command)
        if watch is not None and estimate is not None:
            watch(node, estimate)
        state: Inputs = () if estimate is None else (("estimator/state", estimate),)
        if estimate is not None:
            believed.append(
                (np.array([estimate.x, estimate.y]), np.array([(part.x, part.y) for part in estimate.parts]))
            )
        command = (("controller/command", node.step(_step(tick, state)).outputs[0].message),)
        if result.finished:
            break
    assert last is not None
    return _measures(task, last, truth, believed)


class _Measured:
    """Positions as measured, taken for the estimate, with the measurement's deviation."""

    def __init__(self, seed: int, variance: float) -> None:
        self._seed, self._variance = seed, variance

    def step(
        self,
        tick: int,
        robot: RobotState,
        parts: PartsState,
        command: Inputs,  # noqa: ARG002 - only filters know what was commanded
    ) -> Estimate | None:
        noise = np.zeros((len(parts.parts) + 1, 2))
        if self._variance > 0.0:
            noise = generator(self._seed, "sensors", tick, "overhead").standard_normal(noise.shape)
            noise *= math.sqrt(self._variance)
        variance = self._variance
        return Estimate(
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


class _Filtered:
    """Sensors and the rearrangement estimator."""

    def __init__(self, task: RearrangementTask, seed: int, variance: float, motion: float, particles: int) -> None:
        overhead = OverheadSensor(variance=variance)
        config = RearrangementConfig(
            n=particles,
            measurement_variance=variance,
            process_variance=motion,
            robot_grey=overhead.robot_grey,
            part_grey=overhead.part_grey,
        )
        sensors = SimulatedSensorsConfig(gripper=GripperSensor(), overhead=overhead)
        self._sensors = SimulatedSensors(config=sensors, seed=seed, tick_s=TICK_S, task=task, landmarks=())
        self._estimator = RearrangementEstimator(config=config, seed=seed, tick_s=TICK_S, task=task)

    def step(self, tick: int, robot: RobotState, parts: PartsState, command: Inputs) -> Estimate | None:
        sensed = self._sensors.step(_step(tick, (("truth/robot", robot), ("truth/parts", parts)))).outputs
        inputs = tuple(
            (output.topic, output.message) for output in sensed if isinstance(output.message, Detections | Gripper)
        )
        outputs = self._estimator.step(_step(tick, (*inputs, *command))).outputs
        return next((output.message for output in outputs if isinstance(output.message, Estimate)), None)


def _step(tick: int, messages: Inputs) -> Step:
    stamp = tick * TICK_NS
    return Step(tick, tick, stamp, tuple(Received(topic, "", "", tick, stamp, message) for topic, message in messages))


def _measures(
    task: RearrangementTask,
    last: PartsState,
    truth: list[tuple[FloatArray, FloatArray]],
    believed: list[tuple[FloatArray, FloatArray]],
) -> PartsRun:
    goals = np.array([part.goal for part in task.parts])
    radii = np.array([part.radius for part in task.parts])
    robot, parts = (np.array(column) for column in zip(*truth, strict=True))
    robot_estimate, parts_estimate = (np.array(column) for column in zip(*believed, strict=True))
    late = len(truth) - len(believed)  # the estimator may need a few ticks until it has seen everything
    return PartsRun(
        completed=last.finished and all_home(parts[-1], goals, HOME),
        collided=last.contacts > 0,
        npl=normalized_part_length(parts, goals),
        nrl=normalized_robot_length(robot, parts, goals, radii, task.robot_radius),
        pi=positional_inaccuracy(parts[-1], goals, radii),
        final_error=float(np.linalg.norm(parts[-1] - goals, axis=1).mean()),
        rpee=robot_position_error(robot[late:], robot_estimate),
        ppee=part_position_error(parts[late:], parts_estimate),
        ticks=len(truth),
    )
