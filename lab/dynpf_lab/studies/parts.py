"""Runs of the rearrangement task for studies: layouts, one run without a bus, and its measures; pure and seeded."""

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import (
    Command,
    Detections,
    Estimate,
    Gripper,
    Message,
    PartEstimate,
    PartsState,
    PosesInFrame,
    RobotState,
)
from dynpf_runtime.node import Received, Step
from dynpf_systems.parts.config import FilterName, RearrangementConfig, WorkspaceConfig
from dynpf_systems.parts.controller import RearrangementController
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.estimator import RearrangementEstimator
from dynpf_systems.parts.simulator import WorkspaceSimulator
from dynpf_systems.parts.task import NOISE as LEVELS
from dynpf_systems.parts.task import PartSpec, RearrangementTask
from dynpf_systems.rooms.sensors.config import GripperSensor, OverheadSensor, SimulatedSensorsConfig
from dynpf_systems.rooms.sensors.simulated import SimulatedSensors
from numpy.typing import NDArray

from dynpf.metrics.consistency import nees
from dynpf.metrics.rearrangement import (
    all_home,
    bound_ratio,
    kurtosis,
    normalized_part_length,
    normalized_robot_length,
    part_position_error,
    positional_inaccuracy,
    robot_bound,
    robot_position_error,
    signal_to_noise_db,
)
from dynpf.rng import generator

__all__ = [
    "LAYOUTS",
    "NOISE",
    "PROCESS",
    "RADII",
    "SETTLED",
    "TICK_S",
    "Conditions",
    "FloatArray",
    "PartsRun",
    "Record",
    "layout_task",
    "measured",
    "record_parts",
    "run_parts",
]

FloatArray = NDArray[np.float64]
Inputs = tuple[tuple[str, Message], ...]

TICK_S, TICK_NS = 0.05, 50_000_000
HOME = 0.05  # metres from the goal within which a part counts as home at the end of a study's run

NOISE = {level: noise.measurement for level, noise in LEVELS.items()}
"""Measurement variance in m^2 (PARTS chapter 4)."""
PROCESS = LEVELS["low"].process
"""Variance of the robot's motion, m^2 a tick and coordinate, where there is noise."""
MAX_TICKS = 6000
SETTLED = 20
"""Ticks after which the robot's filter is judged."""


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


class Record(NamedTuple):
    """What happened, tick by tick. Estimates begin ``late`` ticks after the truth: first everything must be seen.

    Arrays over time have one row a tick: positions (T, 2) and (T, p, 2), variances and speeds (T,), seconds spent in a
    step of the estimator and of the controller (T, 2). ``clouds`` are those that were published, (2, M) each.
    """

    task: RearrangementTask
    last: PartsState
    robot: FloatArray
    parts: FloatArray
    speeds: FloatArray
    late: int
    robot_estimate: FloatArray
    covariances: FloatArray  # (T', 2, 2)
    parts_estimate: FloatArray
    held: NDArray[np.int64]  # (T',): the part that is thought to be in the gripper, or -1
    modes: list[str]  # (T',): of the command that followed
    clouds: list[FloatArray]
    seconds: FloatArray
    measurement_variance: float
    process_variance: float

    @property
    def errors(self) -> FloatArray:
        """Where the robot was thought to be against where it was, (T', 2)."""
        return self.robot_estimate - self.robot[self.late :]

    @property
    def information(self) -> FloatArray:
        """What the readings of each tick tell of a coordinate of the robot, (T',): of its disc and of what it holds."""
        sights = 1.0 + (self.held >= 0).astype(np.float64)
        return sights / self.measurement_variance


class PartsRun(NamedTuple):
    """The measures of one run; lengths in metres. Those of the robot's filter begin when it has settled."""

    completed: bool  # finished, and every part is home
    collided: bool
    npl: float
    nrl: float
    pi: float
    final_error: float  # mean over parts
    rpee: float
    ppee: float
    ticks: int
    snr_db: float = math.nan
    kurtosis: float = math.nan  # of the particles, mean over the clouds that were published
    crlb_ratio: float = math.nan  # RMS error of the robot over the posterior Cramer-Rao bound
    nees: float = math.nan  # mean over ticks


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
    robot_filter: FilterName = "optimal",
    process_variance: float | None = None,
    controller: RearrangementControllerConfig | None = None,
    max_ticks: int = MAX_TICKS,
    watch: Callable[[RearrangementController, Estimate], None] | None = None,
) -> PartsRun:
    """Run the loop to its end, and measure it; see ``Conditions`` and ``record_parts``."""
    conditions = Conditions(variance, particles, robot_filter, process_variance, controller, max_ticks)
    return measured(record_parts(task, seed, conditions, watch))


def record_parts(
    task: RearrangementTask,
    seed: int,
    conditions: Conditions,
    watch: Callable[[RearrangementController, Estimate], None] | None = None,
) -> Record:
    """Run the loop of simulator, sensors, estimator and controller to its end.

    ``watch`` is shown each tick's estimate before the controller is.
    """
    variance, motion = conditions.variance, conditions.motion_variance
    workspace = WorkspaceConfig(process_variance=motion)
    simulator = WorkspaceSimulator(config=workspace, seed=seed, tick_s=TICK_S, task=task)
    estimates = _Filtered(task, seed, conditions) if conditions.particles else _Measured(seed, variance)
    config = conditions.controller or RearrangementControllerConfig()
    node = RearrangementController(config=config, tick_s=TICK_S, task=task)
    robots: list[RobotState] = []
    places: list[PartsState] = []
    believed: list[Estimate] = []
    commands: list[Command] = []
    seconds: list[tuple[float, float]] = []
    command: Inputs = ()
    for tick in range(conditions.max_ticks):
        result = simulator.step(_step(tick, command))
        robot, parts = (output.message for output in result.outputs[:2])
        assert isinstance(robot, RobotState)
        assert isinstance(parts, PartsState)
        robots.append(robot)
        places.append(parts)
        estimate = estimates.step(tick, robot, parts, command)
        if watch is not None and estimate is not None:
            watch(node, estimate)
        state: Inputs = () if estimate is None else (("estimator/state", estimate),)
        begun = time.perf_counter()
        decided = node.step(_step(tick, state)).outputs[0].message
        spent = time.perf_counter() - begun
        assert isinstance(decided, Command)
        if estimate is not None:
            believed.append(estimate)
            commands.append(decided)
            seconds.append((estimates.seconds, spent))
        command = (("controller/command", decided),)
        if result.finished:
            break
    return Record(
        task=task,
        last=places[-1],
        robot=np.array([(one.x, one.y) for one in robots]),
        parts=np.array([[(part.x, part.y) for part in one.parts] for one in places]),
        speeds=np.array([one.v for one in robots]),
        late=len(robots) - len(believed),
        robot_estimate=np.array([(one.x, one.y) for one in believed]).reshape(-1, 2),
        covariances=np.array([one.covariance for one in believed]).reshape(-1, 3, 3)[:, :2, :2],
        parts_estimate=np.array([[(part.x, part.y) for part in one.parts] for one in believed]),
        held=np.array([one.held for one in believed], dtype=np.int64),
        modes=[one.mode for one in commands],
        clouds=estimates.clouds,
        seconds=np.array(seconds).reshape(-1, 2),
        measurement_variance=variance,
        process_variance=motion,
    )


def measured(record: Record) -> PartsRun:
    """Return the measures of a run."""
    task, parts = record.task, record.parts
    goals = np.array([part.goal for part in task.parts])
    radii = np.array([part.radius for part in task.parts])
    run = PartsRun(
        completed=record.last.finished and all_home(parts[-1], goals, HOME),
        collided=record.last.contacts > 0,
        npl=normalized_part_length(parts, goals),
        nrl=normalized_robot_length(record.robot, parts, goals, radii, task.robot_radius),
        pi=positional_inaccuracy(parts[-1], goals, radii),
        final_error=float(np.linalg.norm(parts[-1] - goals, axis=1).mean()),
        rpee=robot_position_error(record.robot[record.late :], record.robot_estimate),
        ppee=part_position_error(parts[record.late :], record.parts_estimate),
        ticks=len(parts),
    )
    if record.measurement_variance == 0.0 or len(record.errors) <= SETTLED:
        return run
    settled = slice(SETTLED, None)
    errors = record.errors[settled]
    bounds = robot_bound(record.information, record.process_variance).noisy[settled]
    return run._replace(
        snr_db=signal_to_noise_db(record.speeds, record.measurement_variance),
        kurtosis=float(np.mean([kurtosis(cloud) for cloud in record.clouds])) if record.clouds else math.nan,
        crlb_ratio=bound_ratio(np.linalg.norm(errors, axis=1), bounds),
        nees=float(np.mean(nees(errors.T, record.covariances[settled]))),
    )


class _Measured:
    """Positions as measured, taken for the estimate, with the measurement's deviation."""

    def __init__(self, seed: int, variance: float) -> None:
        self._seed, self._variance = seed, variance
        self.clouds: list[FloatArray] = []
        self.seconds = 0.0

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

    def __init__(self, task: RearrangementTask, seed: int, conditions: Conditions) -> None:
        self.clouds: list[FloatArray] = []
        self.seconds = 0.0
        overhead = OverheadSensor(variance=conditions.variance)
        config = RearrangementConfig(
            filter=conditions.robot_filter,
            n=conditions.particles,
            encoder_variance=0.0,
            measurement_variance=conditions.variance,
            process_variance=conditions.motion_variance,
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
        step = _step(tick, (*inputs, *command))
        begun = time.perf_counter()
        outputs = self._estimator.step(step).outputs
        self.seconds = time.perf_counter() - begun
        for output in outputs:
            if isinstance(output.message, PosesInFrame):
                places = [(pose.position.x, pose.position.y) for pose in output.message.poses]
                self.clouds.append(np.array(places).T)
        return next((output.message for output in outputs if isinstance(output.message, Estimate)), None)


def _step(tick: int, messages: Inputs) -> Step:
    stamp = tick * TICK_NS
    return Step(tick, tick, stamp, tuple(Received(topic, "", "", tick, stamp, message) for topic, message in messages))
