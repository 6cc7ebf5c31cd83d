"""The room simulator: a unicycle robot among walls, landmarks, people and doors, driven by speed and turning rate."""

import math
from functools import cached_property

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    ArrowPrimitive,
    Color,
    Command,
    CylinderPrimitive,
    Drive,
    LinePrimitive,
    Message,
    Place,
    Point3,
    Pose,
    Quaternion,
    RobotState,
    SceneEntity,
    SceneUpdate,
    SetDoor,
    TextPrimitive,
    Timestamp,
    Vector3,
    planar_pose,
    timestamp,
)
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.driven import Driven
from dynpf_services.scenario.context import Context

from dynpf.measurement.ray import ray_segments
from dynpf.portable import dist, sincos
from dynpf.rng import generator
from dynpf.se2 import arc_displacement, compose
from dynpf_systems.rooms.clearance import clearance_of, from_segments
from dynpf_systems.rooms.company import People, closed_doors
from dynpf_systems.rooms.config import Driver, RoomConfig
from dynpf_systems.rooms.maps import NO_MAPS, Maps, maps_of
from dynpf_systems.rooms.messages import Barrier, Disc, Obstacles
from dynpf_systems.rooms.steering import steer

__all__ = ["RoomSimulator", "build"]

SCENE = Every(0.2)
LOOP, PAIRS = 1, 2  # how Foxglove's lines connect their points
WALL_COLOR = Color(r=0.35, g=0.35, b=0.35)
LANDMARK_COLOR = Color(r=0.85, g=0.55, b=0.1)
ROBOT_COLOR = Color(r=0.15, g=0.4, b=0.8)
PERSON_COLOR = Color(r=0.55, g=0.3, b=0.6)
DOOR_COLOR = Color(r=0.6, g=0.4, b=0.2)


class RoomSimulator:
    """True world of a room with landmarks; the source of its run.

    Each step is one tick. The twist in truth/robot is that of the last command with the motion's noise; it holds from
    its stamp to the next, and the next step finds the robot at the end of that arc. A robot that would leave the room,
    or run into a wall of the map or a closed door, is held there while its wheels turn on. Raises ScenarioError for a
    start, or a kidnapping, to where it does not fit, and for people or doors without a map.
    """

    def __init__(
        self,
        *,
        config: RoomConfig,
        seed: int,
        tick_s: float,
        landmarks: tuple[Landmark, ...] = (),
        maps: Maps = NO_MAPS,
        name: str = "simulator",
    ) -> None:
        self.name = name
        self.config = config
        self.seed = seed
        self.tick_s = tick_s
        self.landmarks = landmarks
        self._segments = None if maps.segments is None else maps.segments.segments
        self._clearance = clearance_of(maps)
        self._check_fits("start", config.start)
        for index, kidnapping in enumerate(config.kidnappings):
            self._check_fits(f"kidnappings.{index}.to", kidnapping.to)
        self._pose = config.start
        self._command = (0.0, 0.0)  # forward speed and turning rate
        self._twist = (0.0, 0.0, 0.0)  # true forward speed and turning rate, and rate of turning on the spot besides
        self._finished = False
        self._scene_ns: int | None = None
        self._reached = 0  # of the driver's waypoints
        self._driven: Driven | None = None
        self._held_doors: dict[int, bool] = {}  # closed or not, as a person has them
        self._doors = closed_doors(config.doors, 0.0, self._pose[:2])
        self._people = self._drawn_people(maps)

    @property
    def _has_company(self) -> bool:
        return self._people is not None or bool(self.config.doors)

    def step(self, step: Step) -> Result:
        """Advance the world by one tick under the last command; return the true state, obstacles and pictures."""
        self._move()
        for kidnapping in self.config.kidnappings:
            self._pose = kidnapping.to if kidnapping.tick == step.tick else self._pose
        for received in step.inputs:
            self._change(received.message, step.stamp_ns)
        self._driven = None if self._driven is None or self._driven.is_over(step.stamp_ns) else self._driven
        self._doors = closed_doors(self.config.doors, step.stamp_ns * 1e-9, self._pose[:2], self._held_doors)
        if self._people is not None:
            self._people.walk(step.number, self.tick_s, self._pose[:2], self._doors)
        if self.config.driver is None:
            self._obey(step)
        else:
            self._drive(self.config.driver)
        self._twist = self._perturbed(step.number)
        x, y, theta = self._pose
        v, w, _ = self._twist
        outputs = [Output("truth/robot", RobotState(x=x, y=y, theta=theta, v=v, w=w))]
        if self._has_company:
            outputs.append(Output("truth/obstacles", self._obstacles()))
        if SCENE.due(step.stamp_ns, self._scene_ns):
            self._scene_ns = step.stamp_ns
            outputs.append(Output("truth/scene", self._scene(timestamp(step.stamp_ns))))
        return Result(tuple(outputs), finished=self._finished)

    def refuses(self, act: Message) -> str:
        """Return why a person cannot put the robot there, or has no such door."""
        match act:
            case Place(x=x, y=y) if not self._fits((x, y, 0.0)):
                return f"the robot does not fit into the room at ({x:.3f}, {y:.3f}) m"
            case SetDoor(door=door) if door >= len(self.config.doors):
                return f"there is no door {door + 1}; the room has {len(self.config.doors)}"
        return ""

    def _change(self, act: Message, stamp_ns: int) -> None:
        """Change the world as a person does."""
        match act:
            case Drive():
                self._driven = Driven.by(act, stamp_ns)
            case Place(x=x, y=y, theta=theta):
                self._pose = (x, y, math.remainder(theta, math.tau))
            case SetDoor(door=door, to="scheduled"):
                self._held_doors.pop(door, None)
            case SetDoor(door=door, to=to):
                self._held_doors[door] = to == "closed"

    def _move(self) -> None:
        v, w, spin = self._twist
        arc = arc_displacement(v * self.tick_s, w * self.tick_s)
        x, y, theta = compose(np.array(self._pose), arc).tolist()
        self._pose = self._held(x, y, math.remainder(theta + spin * self.tick_s, math.tau))

    def _obey(self, step: Step) -> None:
        for received in step.inputs:
            command = received.message
            if isinstance(command, Command):
                speed = _clip(command.vx, self.config.max_speed)
                self._command = speed, _clip(command.w, self.config.max_turn_rate)
                self._finished = self._finished or command.finished

    def _drive(self, driver: Driver) -> None:
        """Head for the next waypoint; stop before people and closed doors."""
        waypoint = driver.waypoint(self._reached)
        if waypoint is not None and dist(self._pose[:2], waypoint) <= driver.arrival_radius:
            self._reached += 1
            waypoint = driver.waypoint(self._reached)
        self._finished = waypoint is None
        v, w = (0.0, 0.0) if waypoint is None else steer(driver, self._pose, waypoint)
        free = self._way_ahead() > driver.gap
        self._command = _clip(v, self.config.max_speed) if free else 0.0, _clip(w, self.config.max_turn_rate)

    def _way_ahead(self) -> float:
        """Return how far the robot could go straight on before it would touch a person or a closed door, m."""
        x, y, theta = self._pose
        radius = self.config.robot_radius
        ways = [float(ray_segments(np.array([x, y]), np.array([theta]), self._doors)[0]) - radius]
        if self._people is not None:
            sine, cosine = sincos(theta)
            for dx, dy in (self._people.positions - [x, y]).tolist():
                along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
                touching = radius + self._people.params.radius
                if along > 0.0 and abs(across) < touching:
                    ways.append(along - math.sqrt(touching * touching - across * across))
        return min(ways)

    def _drawn_people(self, maps: Maps) -> People | None:
        if self._clearance is None or maps.grid is None:
            if self.config.people is not None or self.config.doors:
                raise ScenarioError("simulator.people and simulator.doors need a [map]; this run has none")
            return None
        if self.config.people is None:
            return None
        return People(self.config.people, self.seed, self._clearance, maps.grid, self._pose[:2])

    def _perturbed(self, number: int) -> tuple[float, float, float]:
        v, w = self._command
        if self._driven is not None:
            v, w = self._driven.vx, self._driven.w
            v, w = _clip(v, self.config.max_speed), _clip(w, self.config.max_turn_rate)
        v2, w2 = v * v, w * w
        a1, a2, a3, a4, a5, a6 = self.config.alpha
        noise = generator(self.seed, self.name, number, "motion").standard_normal(3).tolist()
        return (
            v + math.sqrt(a1 * v2 + a2 * w2) * noise[0],
            w + math.sqrt(a3 * v2 + a4 * w2) * noise[1],
            math.sqrt(a5 * v2 + a6 * w2) * noise[2],
        )

    def _held(self, x: float, y: float, theta: float) -> tuple[float, float, float]:
        """Return the robot's next pose: a wall of the map stops it, and it slides along the rectangle's sides."""
        if self._clearance is None:
            return *self._inside(x, y), theta
        here_x, here_y, _ = self._pose
        door = from_segments(self._doors)
        gap = min(self._clearance(x, y), door(x, y))
        free = gap >= self.config.robot_radius or gap > min(self._clearance(here_x, here_y), door(here_x, here_y))
        return (x, y, theta) if free else (here_x, here_y, theta)

    def _fits(self, pose: tuple[float, float, float]) -> bool:
        if self._clearance is None:
            return self._inside(*pose[:2]) == pose[:2]
        return self._clearance(*pose[:2]) >= self.config.robot_radius

    def _check_fits(self, key: str, pose: tuple[float, float, float]) -> None:
        if not self._fits(pose):
            room = "map" if self._clearance else f"room of {self.config.width} m x {self.config.height} m"
            raise ScenarioError(
                f"simulator.{key} {pose}: the robot of radius {self.config.robot_radius} m does not fit there"
                f" in the {room}"
            )

    def _inside(self, x: float, y: float) -> tuple[float, float]:
        radius = self.config.robot_radius
        return _clip(x, self.config.width / 2 - radius), _clip(y, self.config.height / 2 - radius)

    def _obstacles(self) -> Obstacles:
        people = [] if self._people is None else self._people.positions.tolist()
        radius = 0.0 if self._people is None else self._people.params.radius
        return Obstacles(
            people=tuple(Disc(x=x, y=y, radius=radius) for x, y in people),
            doors=tuple(Barrier(x1=x1, y1=y1, x2=x2, y2=y2) for x1, y1, x2, y2 in self._doors.tolist()),
        )

    def _scene(self, now: Timestamp) -> SceneUpdate:
        shapes = (self._room_shape(now), self._landmark_shapes(now), self._robot_shape(now))
        return SceneUpdate(entities=(*shapes, self._company_shapes(now)) if self._has_company else shapes)

    def _company_shapes(self, now: Timestamp) -> SceneEntity:
        obstacles = self._obstacles()
        ends = tuple(Point3(x=x, y=y) for x, y in self._doors.reshape(-1, 2).tolist())
        doors = LinePrimitive(
            type=PAIRS, pose=_at(0.0, 0.0, 0.0), thickness=0.05, scale_invariant=False, points=ends, color=DOOR_COLOR
        )
        people = tuple(_cylinder(person.x, person.y, person.radius, 1.7, PERSON_COLOR) for person in obstacles.people)
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="company", cylinders=people, lines=(doors,))

    def _room_shape(self, now: Timestamp) -> SceneEntity:
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="room", lines=(self._walls,))

    @cached_property
    def _walls(self) -> LinePrimitive:
        """The map's segments or the rectangle as lines; a grid has too many cells to draw."""
        kind, points = LOOP, tuple[Point3, ...]()
        if self._segments is not None:
            kind, points = PAIRS, tuple(Point3(x=x, y=y) for x, y in self._segments.reshape(-1, 2).tolist())
        elif self._clearance is None:
            x, y = self.config.width / 2, self.config.height / 2
            points = tuple(Point3(x=a, y=b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y)))
        return LinePrimitive(
            type=kind, pose=_at(0.0, 0.0, 0.0), thickness=0.03, scale_invariant=False, points=points, color=WALL_COLOR
        )

    def _landmark_shapes(self, now: Timestamp) -> SceneEntity:
        posts, labels = self._marks
        return SceneEntity(timestamp=now, frame_id=frames.MAP, id="landmarks", cylinders=posts, texts=labels)

    @cached_property
    def _marks(self) -> tuple[tuple[CylinderPrimitive, ...], tuple[TextPrimitive, ...]]:
        """The landmarks as posts, and their labels."""
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
        return posts, labels

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
        """Return pose, command, route progress and people."""
        return {
            "pose": list(self._pose),
            "command": list(self._command),
            "twist": list(self._twist),
            "finished": self._finished,
            "scene_ns": self._scene_ns,
            **({} if self.config.driver is None else {"reached": self._reached}),
            **({} if not self._has_company else {"doors": self._doors}),
            **({} if self._people is None else self._people.freeze()),
            **({} if self._driven is None else {"driven": list(self._driven)}),
            **({} if not self._held_doors else {"held_doors": [list(pair) for pair in self._held_doors.items()]}),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        x, y, theta = state["pose"]
        v, w = state["command"]
        true_v, true_w, spin = state["twist"]
        self._pose, self._command, self._twist = (x, y, theta), (v, w), (true_v, true_w, spin)
        self._finished = state["finished"]
        self._scene_ns = state["scene_ns"]
        self._reached = state.get("reached", 0)
        self._doors = np.array(state.get("doors", np.empty((0, 4))))
        self._driven = Driven(*state["driven"]) if "driven" in state else None
        self._held_doors = dict(state.get("held_doors", []))
        if self._people is not None:
            self._people.thaw(state)


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


def build(config: RoomConfig, context: Context) -> RoomSimulator:
    """Return the simulator of a run."""
    return RoomSimulator(
        config=config,
        seed=context.seed,
        tick_s=context.tick_s,
        landmarks=context.fact("landmarks") or (),
        maps=maps_of(context),
        name=context.name,
    )
