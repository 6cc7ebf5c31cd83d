"""The rearrangement workspace: a disc robot with a gripper, disc parts, walls; it integrates the commands.

The robot moves as commanded, plus process noise. A part moves only in the gripper, whose jaws centre it at the contact
distance d in the direction of the gripper (PARTS section 2.2). Nothing is pushed; overlapping discs and walls count as
contacts. A scenario may disturb the run by parts that slip, are moved by someone, or are hidden.
"""

import math

import msgspec
import numpy as np
from dynpf_protocol.messages import (
    Command,
    CompressedImage,
    Message,
    Move,
    Place,
    PlaceBody,
    RobotState,
    timestamp,
)
from dynpf_runtime.every import Every
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.driven import Driven
from dynpf_services.scenario.context import Context

from dynpf.fields.clearance import disc_clearances
from dynpf.fields.layout import Layout
from dynpf.portable import atan2, hypot, norm, sincos
from dynpf.rng import Draws, generator
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray
from dynpf_systems.parts.camera import CAMERA_FRAME, DrawnDisc, board_discs, encode, render
from dynpf_systems.parts.camera_model import CameraParams
from dynpf_systems.parts.config import WorkspaceConfig
from dynpf_systems.parts.messages import PartsCommand, PartsState, PartState
from dynpf_systems.parts.scene import draw_scene
from dynpf_systems.parts.task import RearrangementTask, layout_of, task_of

__all__ = ["WorkspaceSimulator", "build", "draw_starts"]


SCENE = Every(0.2)
DRAWS = 200  # attempts to place a disc before all are drawn again
RESTARTS = 200


class WorkspaceSimulator:
    """The source of a rearrangement run: true poses, contacts, and the end once the controller has finished."""

    def __init__(
        self,
        *,
        config: WorkspaceConfig,
        seed: int,
        tick_s: float,
        task: RearrangementTask,
        name: str = "simulator",
    ) -> None:
        """Place the robot and the parts; raises ValueError if they do not fit or a disturbed part does not exist."""
        self.name = name
        self._task = task
        self._layout = layout_of(task)
        self._config = config
        given = config.process_variance
        self._process_std = math.sqrt(task.variances.process if given is None else given)
        self._seed = seed
        self._tick_s = tick_s
        for part in [*(put.part for put in config.interventions), *(hiding.part for hiding in config.hidings)]:
            if part >= len(task.parts):
                raise ValueError(f"part {part} shall be moved or hidden; the task has parts 0 to {len(task.parts) - 1}")
        robot, self._parts = draw_starts(task, config, generator(seed, self.name, 0, "start"))
        self._pose = np.append(robot, 0.0)
        self._command = Command()
        self._handling = PartsCommand(mode="idle")
        self._held = -1
        self._contacts = 0
        self._ticks = 0
        self._scene_ns: int | None = None
        self._driven: Driven | None = None

    def step(self, step: Step) -> Result:
        """Advance the world by one tick under the last commands; return the true state, pictures and frames."""
        for item in step.inputs:
            match item.message:
                case Command():
                    self._command = item.message
                case PartsCommand():
                    self._handling = item.message
                case Move():
                    self._driven = Driven.by(item.message, step.stamp_ns)
        self._driven = None if self._driven is None or self._driven.is_over(step.stamp_ns) else self._driven
        if self._ticks > 0:  # the first tick publishes the starts
            self._grip(step.number)
            self._move(step.number)
            self._intervene()
        for item in step.inputs:
            self._obey(item.message)
        self._ticks += 1
        self._contacts += _touching(self._pose[:2], self._parts, self._held, self._layout)
        outputs = [Output("truth/robot", self._robot_state()), Output("truth/parts", self._parts_state())]
        if SCENE.due(step.stamp_ns, self._scene_ns):
            self._scene_ns = step.stamp_ns
            scene = draw_scene(self._pose, self._parts, self._layout, timestamp(step.stamp_ns))
            outputs.append(Output("truth/scene", scene))
        if self._config.camera is not None:
            outputs.append(Output("camera/image", self._photograph(self._config.camera, step)))
        return Result(tuple(outputs), finished=self._command.finished or self._handling.mode == "undecided")

    def freeze(self) -> State:
        """Return pose, parts, commands and counters."""
        return {
            "pose": self._pose.copy(),
            "parts": self._parts.copy(),
            "command": msgspec.to_builtins(self._command),
            "handling": msgspec.to_builtins(self._handling),
            "held": self._held,
            "contacts": self._contacts,
            "ticks": self._ticks,
            "scene_ns": self._scene_ns,
            **({} if self._driven is None else {"driven": list(self._driven)}),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._pose, self._parts = state["pose"].copy(), state["parts"].copy()
        self._command = msgspec.convert(state["command"], Command)
        self._handling = msgspec.convert(state["handling"], PartsCommand)
        self._held, self._contacts = state["held"], state["contacts"]
        self._ticks, self._scene_ns = state["ticks"], state["scene_ns"]
        self._driven = Driven(*state["driven"]) if "driven" in state else None

    def refuses(self, act: Message) -> str:
        """Return why a robot or a part cannot be put where a person wants it."""
        match act:
            case PlaceBody(body=part) if part >= len(self._parts):
                return f"there is no part {part + 1}; the task has {len(self._parts)}"
            case PlaceBody(body=part, x=x, y=y):
                return self._in_the_way(np.array([x, y]), part, f"part {part + 1}")
            case Place(x=x, y=y):
                return self._in_the_way(np.array([x, y]), -1, "the robot")
        return ""

    def _in_the_way(self, place: FloatArray, part: int, name: str) -> str:
        """Return what a disc would touch at a place, "" if nothing; a part that the robot holds goes with it."""
        layout, held = self._layout, self._held
        radius = layout.robot_radius if part < 0 else float(layout.radii[part])
        if np.any(np.abs(place) + radius > layout.half_size):
            return f"{name} does not fit into the workspace at ({place[0]:.3f}, {place[1]:.3f}) m"
        others = [index for index in range(len(self._parts)) if index not in (part, held if part < 0 else part)]
        gaps = disc_clearances(place, radius, self._parts[others], layout.radii[others])
        robot = disc_clearances(place, radius, self._pose[None, :2], np.array([layout.robot_radius]))
        if np.any(gaps < 0.0) or (part >= 0 and robot[0] < 0.0):
            return f"{name} would touch another disc at ({place[0]:.3f}, {place[1]:.3f}) m"
        return ""

    def _obey(self, act: Message) -> None:
        """Put the robot, or a part, where a person has it."""
        match act:
            case Place(x=x, y=y, theta=theta):
                self._pose = np.array([x, y, math.remainder(theta, math.tau)])
                if self._held >= 0:
                    self._parts[self._held] = self._layout.held_position(self._pose, self._held)
            case PlaceBody(body=part, x=x, y=y):
                self._parts[part] = (x, y)
                self._held = -1 if self._held == part else self._held

    def _grip(self, number: int) -> None:
        """Open or close the gripper; a part in its jaws is pulled to the contact distance, or slips."""
        if not self._handling.grip:
            self._held = -1
        elif self._held < 0 and (part := self._part_in_jaws()) >= 0:
            slips = generator(self._seed, self.name, number, "slip").random() < self._config.slip_probability
            if slips:
                self._slip(part)
            else:
                self._held = part

    def _slip(self, part: int) -> None:
        """Move the part ahead of the jaws; halve the distance while it would touch something there."""
        sine, cosine = sincos(float(self._pose[2]))
        ahead = np.array([cosine, sine])
        start = self._parts[part].copy()
        for share in (1.0, 0.5, 0.25, 0.0):
            self._parts[part] = start + share * self._config.slip_distance * ahead
            if not _touching(self._pose[:2], self._parts, -1, self._layout):
                break

    def _intervene(self) -> None:
        for intervention in self._config.interventions:
            if intervention.tick == self._ticks:
                self._parts[intervention.part] = intervention.to
                self._held = -1 if self._held == intervention.part else self._held

    def _move(self, number: int) -> None:
        noise = generator(self._seed, self.name, number, "process").standard_normal(2)
        vx, vy, w = self._commanded
        velocity = np.array([vx, vy])
        step = velocity * self._tick_s + self._process_std * noise
        theta = math.remainder(self._pose[2] + w * self._tick_s, math.tau)
        self._pose = np.append(self._pose[:2] + step, theta)
        if self._held >= 0:
            self._parts[self._held] = self._layout.held_position(self._pose, self._held)

    @property
    def _commanded(self) -> tuple[float, float, float]:
        """The velocity and the turning rate by which the robot is driven."""
        if self._driven is not None:
            return self._driven.vx, self._driven.vy, self._driven.w
        return self._command.vx, self._command.vy, self._command.w

    def _part_in_jaws(self) -> int:
        """Return the nearest part that the jaws can close on, or -1."""
        offset = self._parts - self._pose[:2]
        gaps = disc_clearances(self._pose[:2], self._layout.robot_radius, self._parts, self._layout.radii)
        aside = np.abs(wrap_angle(atan2(offset[:, 1], offset[:, 0]) - self._pose[2]))
        caught = (gaps <= self._layout.reach + self._config.grip_tolerance) & (aside <= self._config.grip_angle)
        return int(np.argmin(np.where(caught, gaps, np.inf))) if caught.any() else -1

    def _photograph(self, camera: CameraParams, step: Step) -> CompressedImage:
        discs = self._discs(camera) if camera.board is None or self._ticks > 1 else board_discs(camera.board, camera)
        frame = render(discs, camera, self._seed, step.tick)
        return CompressedImage(
            timestamp=timestamp(step.stamp_ns), frame_id=CAMERA_FRAME, data=encode(frame, camera), format="jpeg"
        )

    def _discs(self, camera: CameraParams) -> list[DrawnDisc]:
        x, y, theta = self._pose.tolist()
        hidden = self._hidden(self._ticks - 1)
        discs = [
            DrawnDisc(part_x, part_y, spec.radius, spec.colour or camera.part_colour)
            for index, ((part_x, part_y), spec) in enumerate(zip(self._parts.tolist(), self._task.parts, strict=True))
            if index not in hidden
        ]
        colour = self._task.robot_colour or camera.robot_colour
        return [*discs, DrawnDisc(x, y, self._task.robot_radius, colour, theta)]

    def _robot_state(self) -> RobotState:
        vx, vy, w = self._commanded
        x, y, theta = self._pose.tolist()
        return RobotState(x=x, y=y, theta=theta, v=hypot(vx, vy), w=w)

    def _parts_state(self) -> PartsState:
        parts = tuple(
            PartState(x=x, y=y, radius=spec.radius, goal_x=spec.goal[0], goal_y=spec.goal[1])
            for (x, y), spec in zip(self._parts.tolist(), self._task.parts, strict=True)
        )
        return PartsState(
            parts=parts,
            held=self._held,
            contacts=self._contacts,
            finished=self._command.finished,
            hidden=self._hidden(self._ticks - 1),
        )

    def _hidden(self, tick: int) -> tuple[int, ...]:
        return tuple(sorted({hiding.part for hiding in self._config.hidings if 0 <= tick - hiding.tick < hiding.ticks}))


def draw_starts(task: RearrangementTask, config: WorkspaceConfig, random: Draws) -> tuple[FloatArray, FloatArray]:
    """Return start positions of the robot, (2,), and the parts, (p, 2): those given, the others drawn.

    Positions are uniform over the workspace, subject to the configured gaps. Raises ValueError if no free positions are
    found.
    """
    given = [*(spec.start for spec in task.parts), task.robot_start]
    radii = np.array([*(spec.radius for spec in task.parts), task.robot_radius])
    half_size = np.array([task.width, task.height]) / 2.0
    for _ in range(RESTARTS):
        placed = {index: np.array(start) for index, start in enumerate(given) if start is not None}
        for index in [index for index, start in enumerate(given) if start is None]:
            limit = half_size - radii[index] - config.start_wall_gap
            others = np.array(list(placed.values())).reshape(-1, 2)
            other_radii = radii[list(placed)]
            for _ in range(DRAWS):
                centre = random.uniform(-1.0, 1.0, 2) * limit
                gaps = disc_clearances(centre, radii[index], others, other_radii)
                if np.all(gaps >= config.start_gap) and np.all(limit >= 0.0):
                    placed[index] = centre
                    break
            else:
                break
        else:
            positions = np.array([placed[index] for index in range(len(given))])
            return positions[-1], positions[:-1]
    raise ValueError(
        f"start_gap {config.start_gap} m, start_wall_gap {config.start_wall_gap} m: found no free positions for "
        f"{len(task.parts)} parts and the robot in {task.width} m x {task.height} m; ask for smaller gaps"
    )


def _touching(robot: FloatArray, parts: FloatArray, held: int, layout: Layout) -> bool:
    """Return whether two discs, or a disc and a wall, overlap; a held part may touch the robot."""
    centres, radii = np.vstack([parts, robot]), np.append(layout.radii, layout.robot_radius)
    if np.any(np.abs(centres) + radii[:, None] > layout.half_size):
        return True
    offset = centres[:, None, :] - centres
    overlap = norm(offset, axis=2) < radii[:, None] + radii
    np.fill_diagonal(overlap, val=False)
    if held >= 0:
        overlap[held, -1] = overlap[-1, held] = False
    return bool(overlap.any())


def build(config: WorkspaceConfig, context: Context) -> WorkspaceSimulator:
    """Return the simulator of a run."""
    return WorkspaceSimulator(
        config=config, seed=context.seed, tick_s=context.tick_s, task=task_of(context), name=context.name
    )
