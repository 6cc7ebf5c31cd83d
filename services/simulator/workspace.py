"""The rearrangement workspace: a disc robot with a gripper, disc parts, walls; integrates what is commanded.

The robot moves as commanded, plus process noise. A part moves only in the gripper, whose jaws centre it: it is then
at the contact distance d in the direction of the gripper (PARTS section 2.2). Nothing is pushed; discs and walls that
overlap are counted as contacts.
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf.fields.clearance import disc_clearances, wall_clearances
from dynpf.fields.layout import Layout
from dynpf.rng import generator
from protocol import frames
from protocol.messages import Command, CompressedImage, PartsState, PartState, RobotState, timestamp
from services.node import Output, Result, State, Step
from services.simulator.camera import CameraParams, DrawnDisc, board_discs, encode, render
from services.simulator.config import WorkspaceConfig
from services.simulator.workspace_scene import draw_scene
from services.task import RearrangementTask, layout_of

__all__ = ["WorkspaceSimulator", "draw_starts"]

FloatArray = NDArray[np.float64]

SCENE_PERIOD_NS = 200_000_000
DRAWS = 200  # of one disc before all are drawn anew
RESTARTS = 200


class WorkspaceSimulator:
    """The source of a rearrangement run: true poses, contacts, and the end when the controller has finished."""

    name = "simulator"
    reads = frozenset({"controller/command"})
    writes = frozenset({"truth/robot", "truth/parts", "truth/scene", "camera/image"})

    def __init__(self, *, config: WorkspaceConfig, seed: int, tick_s: float, task: RearrangementTask) -> None:
        """Place the robot and the parts; raises ValueError when they do not fit."""
        self._task = task
        self._layout = layout_of(task)
        self._config = config
        self._seed = seed
        self._tick_s = tick_s
        robot, self._parts = draw_starts(task, config, generator(seed, self.name, 0, "start"))
        self._pose = np.append(robot, 0.0)
        self._command = Command(mode="idle")
        self._held = -1
        self._contacts = 0
        self._ticks = 0
        self._scene_ns = -SCENE_PERIOD_NS

    def step(self, step: Step) -> Result:
        for item in step.inputs:
            if isinstance(item.message, Command):
                self._command = item.message
        if self._ticks > 0:  # the first tick shows where everything starts
            self._grip()
            self._move(step.number)
        self._ticks += 1
        self._contacts += _touching(self._pose[:2], self._parts, self._held, self._layout)
        outputs = [Output("truth/robot", self._robot_state()), Output("truth/parts", self._parts_state())]
        if step.stamp_ns - self._scene_ns >= SCENE_PERIOD_NS:
            self._scene_ns = step.stamp_ns
            scene = draw_scene(self._pose, self._parts, self._layout, timestamp(step.stamp_ns))
            outputs.append(Output("truth/scene", scene))
        if self._config.camera is not None:
            outputs.append(Output("camera/image", self._photograph(self._config.camera, step)))
        return Result(tuple(outputs), finished=self._command.finished)

    def freeze(self) -> State:
        return {
            "pose": self._pose.copy(),
            "parts": self._parts.copy(),
            "command": msgspec.to_builtins(self._command),
            "held": self._held,
            "contacts": self._contacts,
            "ticks": self._ticks,
            "scene_ns": self._scene_ns,
        }

    def thaw(self, state: State) -> None:
        self._pose, self._parts = state["pose"].copy(), state["parts"].copy()
        self._command = msgspec.convert(state["command"], Command)
        self._held, self._contacts = state["held"], state["contacts"]
        self._ticks, self._scene_ns = state["ticks"], state["scene_ns"]

    def _grip(self) -> None:
        """Open or close the gripper; what its jaws close on, they pull to the contact distance."""
        if not self._command.grip:
            self._held = -1
        elif self._held < 0:
            self._held = self._part_in_jaws()

    def _move(self, number: int) -> None:
        noise = generator(self._seed, self.name, number, "process").standard_normal(2)
        velocity = np.array([self._command.vx, self._command.vy])
        step = velocity * self._tick_s + math.sqrt(self._config.process_variance) * noise
        theta = math.remainder(self._pose[2] + self._command.w * self._tick_s, math.tau)
        self._pose = np.append(self._pose[:2] + step, theta)
        if self._held >= 0:
            self._parts[self._held] = self._layout.held_position(self._pose, self._held)

    def _part_in_jaws(self) -> int:
        """Return the nearest part that the jaws can close on, or -1."""
        offset = self._parts - self._pose[:2]
        gaps = disc_clearances(self._pose[:2], self._layout.robot_radius, self._parts, self._layout.radii)
        directions = np.arctan2(offset[:, 1], offset[:, 0])
        aside = np.abs(np.angle(np.exp(1j * (directions - self._pose[2]))))
        caught = (gaps <= self._layout.reach + self._config.grip_tolerance) & (aside <= self._config.grip_angle)
        return int(np.argmin(np.where(caught, gaps, np.inf))) if caught.any() else -1

    def _photograph(self, camera: CameraParams, step: Step) -> CompressedImage:
        discs = self._discs(camera) if camera.board is None or self._ticks > 1 else board_discs(camera.board, camera)
        frame = render(discs, camera, self._seed, step.tick)
        return CompressedImage(
            timestamp=timestamp(step.stamp_ns), frame_id=frames.CAMERA, data=encode(frame, camera), format="jpeg"
        )

    def _discs(self, camera: CameraParams) -> list[DrawnDisc]:
        x, y, theta = self._pose.tolist()
        discs = [
            DrawnDisc(part_x, part_y, spec.radius, camera.part_colour)
            for (part_x, part_y), spec in zip(self._parts.tolist(), self._task.parts, strict=True)
        ]
        return [*discs, DrawnDisc(x, y, self._task.robot_radius, camera.robot_colour, theta)]

    def _robot_state(self) -> RobotState:
        command = self._command
        x, y, theta = self._pose.tolist()
        return RobotState(x=x, y=y, theta=theta, v=math.hypot(command.vx, command.vy), w=command.w)

    def _parts_state(self) -> PartsState:
        parts = tuple(
            PartState(x=x, y=y, radius=spec.radius, goal_x=spec.goal[0], goal_y=spec.goal[1])
            for (x, y), spec in zip(self._parts.tolist(), self._task.parts, strict=True)
        )
        return PartsState(parts=parts, held=self._held, contacts=self._contacts, finished=self._command.finished)


def draw_starts(
    task: RearrangementTask, config: WorkspaceConfig, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return start positions of the robot, (2,), and the parts, (p, 2): those given, the others drawn.

    Positions are uniform over the workspace, subject to the gaps asked for. Raises ValueError when no free place is
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
        f"start_gap {config.start_gap} m, start_wall_gap {config.start_wall_gap} m: found no free places for "
        f"{len(task.parts)} parts and the robot in {task.width} m x {task.height} m; ask for smaller gaps"
    )


def _touching(robot: FloatArray, parts: FloatArray, held: int, layout: Layout) -> bool:
    """Return whether two discs, or a disc and a wall, overlap; a held part may touch the robot."""
    free = layout.others(held) if held >= 0 else np.arange(len(parts))
    first, second = np.triu_indices(len(parts), 1)
    clearances = [
        disc_clearances(robot, layout.robot_radius, parts[free], layout.radii[free]),
        np.hypot(*(parts[first] - parts[second]).T) - (layout.radii[first] + layout.radii[second]),
        wall_clearances(robot, layout.robot_radius, layout.half_size),
        *(wall_clearances(part, radius, layout.half_size) for part, radius in zip(parts, layout.radii, strict=True)),
    ]
    return bool(np.concatenate(clearances).min() < 0.0)
