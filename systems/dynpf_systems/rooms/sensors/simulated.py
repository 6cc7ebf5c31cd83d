"""Simulated sensors: at each new true state, the readings that the configured sensors would give."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Message, Odometry, RobotState
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf.filters.kalman import Gaussian
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.ray import ray_discs, ray_segments
from dynpf.motion.gyro import GyroOdometry
from dynpf.rng import Draws, generator
from dynpf_systems.parts.messages import PartsState
from dynpf_systems.parts.task import RearrangementTask
from dynpf_systems.rooms.maps import NO_MAPS, Maps, maps_of
from dynpf_systems.rooms.messages import Obstacles
from dynpf_systems.rooms.sensors.config import OdometrySensor, ScanSensor, SimulatedSensorsConfig
from dynpf_systems.rooms.sensors.readings import (
    Floats,
    Rays,
    read_gripper,
    read_gyro,
    read_landmarks,
    read_lines,
    read_odometry,
    read_overhead,
    read_position,
    read_scan,
    rectangle,
)

__all__ = ["SimulatedSensors", "build"]


class SimulatedSensors:
    """Sensor publisher fed by the simulator's truth.

    Speaks only when a newer truth/robot came. A sensor's ``every`` counts true states, so that it holds under either
    clock. Raises ScenarioError for a sensor whose facts (task, landmarks, walls, map) the run does not have.
    """

    def __init__(
        self,
        *,
        config: SimulatedSensorsConfig,
        seed: int,
        tick_s: float,
        task: RearrangementTask | None = None,
        landmarks: tuple[Landmark, ...] = (),
        maps: Maps = NO_MAPS,
        name: str = "sensors",
    ) -> None:
        self.name = name
        if task is None and (config.gripper is not None or config.overhead is not None):
            raise ScenarioError("sensors.gripper and sensors.overhead need a rearrangement task; this run has none")
        if config.landmarks is not None and not landmarks:
            raise ScenarioError("sensors.landmarks needs landmarks; this run has none")
        if config.lines is not None and maps.segments is None:
            raise ScenarioError("sensors.lines needs a map of segments; this run has none")
        self.config = config
        self.seed = seed
        self.tick_s = tick_s
        self.task = task
        self.landmarks = landmarks
        self._rays = _rays(config.scan, task, maps)
        self._segments = np.empty((0, 4)) if maps.segments is None else maps.segments.segments
        self._robot: RobotState | None = None
        self._parts: PartsState | None = None
        self._obstacles: Obstacles | None = None
        self._gyro = _gyro(config)
        self._turning: Gaussian | None = None if self._gyro is None else self._gyro.start()
        self._robot_stamp_ns = -1
        self._parts_stamp_ns = -1
        self._states = 0

    def step(self, step: Step) -> Result:
        if not self._take(step):
            return Result()
        outputs = self._read(step)
        self._states += 1
        return Result(tuple(outputs))

    def _take(self, step: Step) -> bool:
        """Keep the newest truth; return whether the robot's is new."""
        fresh = False
        for received in step.inputs:
            message = received.message
            if isinstance(message, RobotState) and received.stamp_ns > self._robot_stamp_ns:
                self._robot, self._robot_stamp_ns, fresh = message, received.stamp_ns, True
            elif isinstance(message, PartsState) and received.stamp_ns > self._parts_stamp_ns:
                self._parts, self._parts_stamp_ns = message, received.stamp_ns
            elif isinstance(message, Obstacles):
                self._obstacles = message
        return fresh

    def _read(self, step: Step) -> list[Output]:
        config, robot, parts, task = self.config, self._robot, self._parts, self.task
        if robot is None:
            return []
        outputs: list[Output] = []

        def publish(name: str, every: int, read: Callable[[Draws], Message]) -> None:
            if self._states % every == 0:
                outputs.append(Output(f"sensors/{name}", read(generator(self.seed, self.name, step.number, name))))

        if (overhead := config.overhead) is not None and parts is not None and task is not None:
            publish("overhead", overhead.every, lambda rng: read_overhead(overhead, robot, parts, task, rng))
        if (odometry := config.odometry) is not None:
            publish("odometry", odometry.every, lambda rng: self._odometry(odometry, robot, rng))
        if (sensor := config.landmarks) is not None:
            publish("landmarks", sensor.every, lambda rng: read_landmarks(sensor, robot, self.landmarks, rng))
        if (scan := config.scan) is not None:
            publish(
                "scan",
                scan.every,
                lambda rng: read_scan(scan, robot, parts, self._obstacles, self._rays, stamp_ns=step.stamp_ns, rng=rng),
            )
        if (lines := config.lines) is not None:
            publish("lines", lines.every, lambda rng: read_lines(lines, robot, self._segments, rng))
        if (position := config.position) is not None:
            publish("position", position.every, lambda rng: read_position(position, robot, rng))
        if (gripper := config.gripper) is not None and parts is not None and task is not None:
            publish("gripper", gripper.every, lambda rng: read_gripper(gripper, robot, parts, task, rng))
        return outputs

    def _odometry(self, sensor: OdometrySensor, robot: RobotState, rng: Draws) -> Odometry:
        """Return what the wheels say, its turning rate corrected by the gyro if there is one."""
        wheels = read_odometry(sensor, robot, rng)
        if self._gyro is None or self._turning is None or sensor.gyro is None:
            return wheels
        self._turning = self._gyro.update(
            self._turning, wheels.w, read_gyro(sensor.gyro, robot, rng), self.tick_s * sensor.every
        )
        return Odometry(v=wheels.v, w=float(self._turning.mean[0]))

    def rehearse(self) -> None:
        """See Rehearsing."""
        self._rays(np.zeros(2), np.zeros(1))
        ray_discs(np.zeros(2), np.zeros(1), np.zeros((0, 3)))
        ray_segments(np.zeros(2), np.zeros(1), np.zeros((0, 4)))

    def freeze(self) -> State:
        return {
            "robot": msgspec.to_builtins(self._robot),
            "parts": msgspec.to_builtins(self._parts),
            "robot_stamp_ns": self._robot_stamp_ns,
            "parts_stamp_ns": self._parts_stamp_ns,
            "states": self._states,
            **({} if self._obstacles is None else {"obstacles": msgspec.to_builtins(self._obstacles)}),
            **({} if self._turning is None else {"turning": self._turning._asdict()}),
        }

    def thaw(self, state: State) -> None:
        self._robot = msgspec.convert(state["robot"], RobotState | None)
        self._parts = msgspec.convert(state["parts"], PartsState | None)
        self._robot_stamp_ns = state["robot_stamp_ns"]
        self._parts_stamp_ns = state["parts_stamp_ns"]
        self._states = state["states"]
        self._obstacles = msgspec.convert(state.get("obstacles"), Obstacles | None)
        turning = state.get("turning")
        self._turning = None if turning is None else Gaussian(**{key: np.array(turning[key]) for key in turning})


def _rays(scan: ScanSensor | None, task: RearrangementTask | None, maps: Maps) -> Rays:
    """Return how far a scan's beams go: to its own walls, else to the map's, else to the border of the workspace."""
    if scan is None:
        return _to_segments(np.empty((0, 4)))
    if scan.glass and (scan.walls or maps.segments is None):
        raise ScenarioError("sensors.scan.glass: tells of walls of a map of segments; this scan's are not of one")
    if scan.walls:
        return _to_segments(np.array(scan.walls, dtype=np.float64))
    if maps.segments is not None:
        return _to_segments(_opaque(maps.segments.segments, scan.glass))
    if maps.grid is not None:
        return _to_cells(RayCaster(maps.grid), scan.range_max)
    if task is not None:
        return _to_segments(rectangle(task.width, task.height))
    raise ScenarioError(
        "sensors.scan needs walls, a map, or a rearrangement task with its workspace; this run has none of them"
    )


def _opaque(walls: Floats, glass: Sequence[tuple[float, float, float, float]]) -> Floats:
    """Return the walls that are not of glass; raises ScenarioError for glass that is no wall."""
    opaque = np.ones(len(walls), dtype=bool)
    for place, pane in enumerate(glass):
        same = (walls == np.array(pane)).all(axis=1)
        if not same.any():
            raise ScenarioError(f"sensors.scan.glass.{place}: {list(pane)} is no segment of the map")
        opaque &= ~same
    return walls[opaque]


def _gyro(config: SimulatedSensorsConfig) -> GyroOdometry | None:
    if config.odometry is None or config.odometry.gyro is None:
        return None
    return GyroOdometry(config.odometry.gyro.filter)


def _to_segments(walls: Floats) -> Rays:
    return lambda origin, angles: ray_segments(origin, angles, walls)


def _to_cells(caster: RayCaster, range_max: float) -> Rays:
    def rays(origin: Floats, angles: Floats) -> Floats:
        x, y = np.broadcast_to(origin.astype(np.float32)[:, None], (2, angles.size)).copy()
        return caster.ranges(x, y, angles.astype(np.float32), range_max).astype(np.float64)

    return rays


def build(config: SimulatedSensorsConfig, context: Context) -> SimulatedSensors:
    """Return the sensors of a run."""
    return SimulatedSensors(
        config=config,
        seed=context.seed,
        tick_s=context.tick_s,
        task=context.fact("task"),
        landmarks=context.fact("landmarks") or (),
        maps=maps_of(context),
        name=context.name,
    )
