"""The room simulator: a unicycle robot among landmarks, driven by forward speed and turning rate."""

import math

import numpy as np

from dynpf.rng import generator
from dynpf.se2 import arc_displacement, compose
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
from services.node import Output, Result, State, Step
from services.simulator.config import RoomConfig
from services.task import Landmark

__all__ = ["RoomSimulator"]

SCENE_PERIOD_NS = 200_000_000
WALL_COLOR = Color(r=0.35, g=0.35, b=0.35)
LANDMARK_COLOR = Color(r=0.85, g=0.55, b=0.1)
ROBOT_COLOR = Color(r=0.15, g=0.4, b=0.8)


class RoomSimulator:
    """True world of a room with landmarks; the source of its run.

    Each step is one tick. The twist in truth/robot is the one that holds from its stamp to the next: the last command
    and the motion's noise. The next step finds the robot at the end of that arc. A robot that would leave the room is
    held at the wall while its wheels turn on. Raises ScenarioError for a start outside the room.
    """

    name = "simulator"
    reads = frozenset({"controller/command"})
    writes = frozenset({"truth/robot", "truth/scene"})

    def __init__(self, *, config: RoomConfig, seed: int, tick_s: float, landmarks: tuple[Landmark, ...] = ()) -> None:
        self.config = config
        self.seed = seed
        self.tick_s = tick_s
        self.landmarks = landmarks
        if self._held_inside(*config.start) != config.start:
            raise ScenarioError(
                f"simulator.start {config.start}: the robot of radius {config.robot_radius} m does not fit there"
                f" in the room of {config.width} m x {config.height} m"
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
        self._pose = self._held_inside(x, y, math.remainder(theta + spin * self.tick_s, math.tau))

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

    def _held_inside(self, x: float, y: float, theta: float) -> tuple[float, float, float]:
        radius = self.config.robot_radius
        return _clip(x, self.config.width / 2 - radius), _clip(y, self.config.height / 2 - radius), theta

    def _scene(self, now: Timestamp) -> SceneUpdate:
        return SceneUpdate(entities=(self._room_shape(now), self._landmark_shapes(now), self._robot_shape(now)))

    def _room_shape(self, now: Timestamp) -> SceneEntity:
        x, y = self.config.width / 2, self.config.height / 2
        corners = tuple(Point3(x=a, y=b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))
        loop = LinePrimitive(
            type=1, pose=_at(0.0, 0.0, 0.0), thickness=0.03, scale_invariant=False, points=corners, color=WALL_COLOR
        )
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="room", lines=(loop,))

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
