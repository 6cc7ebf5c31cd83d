"""The room simulator: a unicycle robot among landmarks, driven by forward speed and turning rate."""

import math
from collections.abc import Callable

import numpy as np

from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.rng import generator
from dynpf.se2 import FloatArray, arc_displacement, compose
from protocol import frames
from protocol.messages import (
    ArrowPrimitive,
    Color,
    Command,
    CylinderPrimitive,
    LinePrimitive,
    Point3,
    Pose,
    Quaternion,
    RobotState,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
    planar_pose,
    timestamp,
)
from services.errors import ScenarioError
from services.maps import NO_MAPS, Maps
from services.node import Output, Result, State, Step
from services.simulator.config import RoomConfig
from services.task import Landmark

__all__ = ["RoomSimulator"]

Clearance = Callable[[float, float], float]
"""The distance in metres from a point to the nearest wall."""

SCENE_PERIOD_NS = 200_000_000
LOOP, PAIRS = 1, 2  # how Foxglove's lines connect their points
WALL_COLOR = Color(r=0.35, g=0.35, b=0.35)
LANDMARK_COLOR = Color(r=0.85, g=0.55, b=0.1)
ROBOT_COLOR = Color(r=0.15, g=0.4, b=0.8)


class RoomSimulator:
    """True world of a room with landmarks; the source of its run.

    Each step is one tick. The twist in truth/robot is the one that holds from its stamp to the next: the last command
    and the motion's noise. The next step finds the robot at the end of that arc. A robot that would leave the room, or
    run into a wall of the map, is held there while its wheels turn on. Raises ScenarioError for a start where it does
    not fit.
    """

    name = "simulator"
    reads = frozenset({"controller/command"})
    writes = frozenset({"truth/robot", "truth/scene"})

    def __init__(
        self,
        *,
        config: RoomConfig,
        seed: int,
        tick_s: float,
        landmarks: tuple[Landmark, ...] = (),
        maps: Maps = NO_MAPS,
    ) -> None:
        self.config = config
        self.seed = seed
        self.tick_s = tick_s
        self.landmarks = landmarks
        self._segments = None if maps.segments is None else maps.segments.segments
        self._clearance = _clearance(maps)
        if not self._fits(config.start):
            room = "map" if self._clearance else f"room of {config.width} m x {config.height} m"
            raise ScenarioError(
                f"simulator.start {config.start}: the robot of radius {config.robot_radius} m does not fit there"
                f" in the {room}"
            )
        self._pose = config.start
        self._command = (0.0, 0.0)  # forward speed and turning rate
        self._twist = (0.0, 0.0, 0.0)  # true forward speed and turning rate, and rate of turning on the spot besides
        self._finished = False
        self._scene_ns = -SCENE_PERIOD_NS

    def step(self, step: Step) -> Result:
        self._move()
        self._obey(step)
        self._twist = self._perturbed(step.number)
        x, y, theta = self._pose
        v, w, _ = self._twist
        outputs = [Output("truth/robot", RobotState(x=x, y=y, theta=theta, v=v, w=w))]
        if step.stamp_ns - self._scene_ns >= SCENE_PERIOD_NS:
            self._scene_ns = step.stamp_ns
            outputs.append(Output("truth/scene", self._scene(timestamp(step.stamp_ns))))
        return Result(tuple(outputs), finished=self._finished)

    def _move(self) -> None:
        v, w, spin = self._twist
        arc = arc_displacement(v * self.tick_s, w * self.tick_s)
        x, y, theta = compose(np.array(self._pose), arc).tolist()
        self._pose = self._held(x, y, math.remainder(theta + spin * self.tick_s, math.tau))

    def _obey(self, step: Step) -> None:
        for received in step.inputs:
            command = received.message
            if isinstance(command, Command):
                v, w = (command.vx, command.w) if command.mode == "drive" else (0.0, 0.0)
                self._command = _clip(v, self.config.max_speed), _clip(w, self.config.max_turn_rate)
                self._finished = self._finished or command.finished

    def _perturbed(self, number: int) -> tuple[float, float, float]:
        v, w = self._command
        a1, a2, a3, a4, a5, a6 = self.config.alpha
        noise = generator(self.seed, self.name, number, "motion").standard_normal(3).tolist()
        return (
            v + math.sqrt(a1 * v**2 + a2 * w**2) * noise[0],
            w + math.sqrt(a3 * v**2 + a4 * w**2) * noise[1],
            math.sqrt(a5 * v**2 + a6 * w**2) * noise[2],
        )

    def _held(self, x: float, y: float, theta: float) -> tuple[float, float, float]:
        """Return the pose that the robot comes to: before a wall of the map it stays, along the rectangle it slides."""
        if self._clearance is None:
            return *self._inside(x, y), theta
        here_x, here_y, _ = self._pose
        gap = self._clearance(x, y)
        free = gap >= self.config.robot_radius or gap > self._clearance(here_x, here_y)
        return (x, y, theta) if free else (here_x, here_y, theta)

    def _fits(self, pose: tuple[float, float, float]) -> bool:
        if self._clearance is None:
            return self._inside(*pose[:2]) == pose[:2]
        return self._clearance(*pose[:2]) >= self.config.robot_radius

    def _inside(self, x: float, y: float) -> tuple[float, float]:
        radius = self.config.robot_radius
        return _clip(x, self.config.width / 2 - radius), _clip(y, self.config.height / 2 - radius)

    def _scene(self, now: Timestamp) -> SceneUpdate:
        return SceneUpdate(entities=(self._room_shape(now), self._landmark_shapes(now), self._robot_shape(now)))

    def _room_shape(self, now: Timestamp) -> SceneEntity:
        """Draw the map's segments, or the rectangle; a grid's cells would be too many."""
        kind, points = LOOP, tuple[Point3, ...]()
        if self._segments is not None:
            kind, points = PAIRS, tuple(Point3(x=x, y=y) for x, y in self._segments.reshape(-1, 2).tolist())
        elif self._clearance is None:
            x, y = self.config.width / 2, self.config.height / 2
            points = tuple(Point3(x=a, y=b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))
        walls = LinePrimitive(
            type=kind, pose=_at(0.0, 0.0, 0.0), thickness=0.03, scale_invariant=False, points=points, color=WALL_COLOR
        )
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="room", lines=(walls,))

    def _landmark_shapes(self, now: Timestamp) -> SceneEntity:
        posts = tuple(_cylinder(mark.x, mark.y, 0.05, 0.5, LANDMARK_COLOR) for mark in self.landmarks)
        labels = tuple(
            TextPrimitive(
                pose=_at(mark.x, mark.y, 0.6),
                billboard=True,
                font_size=0.15,
                scale_invariant=False,
                color=WALL_COLOR,
                text=str(mark.id),
            )
            for mark in self.landmarks
        )
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="landmarks", cylinders=posts, texts=labels)

    def _robot_shape(self, now: Timestamp) -> SceneEntity:
        x, y, theta = self._pose
        radius = self.config.robot_radius
        nose = ArrowPrimitive(
            pose=planar_pose(x, y, theta),
            shaft_length=radius,
            shaft_diameter=0.3 * radius,
            head_length=0.6 * radius,
            head_diameter=0.6 * radius,
            color=ROBOT_COLOR,
        )
        body = _cylinder(x, y, radius, 0.1, ROBOT_COLOR)
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="robot", cylinders=(body,), arrows=(nose,))

    def freeze(self) -> State:
        return {
            "pose": list(self._pose),
            "command": list(self._command),
            "twist": list(self._twist),
            "finished": self._finished,
            "scene_ns": self._scene_ns,
        }

    def thaw(self, state: State) -> None:
        x, y, theta = state["pose"]
        v, w = state["command"]
        true_v, true_w, spin = state["twist"]
        self._pose, self._command, self._twist = (x, y, theta), (v, w), (true_v, true_w, spin)
        self._finished = state["finished"]
        self._scene_ns = state["scene_ns"]


def _clearance(maps: Maps) -> Clearance | None:
    if maps.segments is not None:
        return _from_segments(maps.segments.segments)
    return None if maps.grid is None else _from_grid(maps.grid)


def _from_segments(segments: FloatArray) -> Clearance:
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    squared = np.sum(along**2, axis=1)

    def clearance(x: float, y: float) -> float:
        from_start = np.array([x, y]) - start
        fraction = np.clip(np.sum(from_start * along, axis=1) / squared, 0.0, 1.0)
        return float(np.min(np.hypot(*(from_start - fraction[:, None] * along).T)))

    return clearance


def _from_grid(grid: OccupancyGrid) -> Clearance:
    field = distance_field(grid.occupied, grid.resolution)
    rows, columns = field.shape

    def clearance(x: float, y: float) -> float:
        column, row = (math.floor(place) for place in grid.to_cells(x, y))
        return float(field[row, column]) if 0 <= column < columns and 0 <= row < rows else 0.0

    return clearance


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _at(x: float, y: float, z: float) -> Pose:
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion())


def _cylinder(x: float, y: float, radius: float, height: float, color: Color) -> CylinderPrimitive:
    return CylinderPrimitive(
        pose=_at(x, y, height / 2),
        size=Vector3(x=2 * radius, y=2 * radius, z=height),
        bottom_scale=1.0,
        top_scale=1.0,
        color=color,
    )
