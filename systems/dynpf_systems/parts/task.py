"""The rearrangement task, a fact of a run that several nodes share."""

from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.context import Context
from msgspec import Meta
from numpy.typing import NDArray

from dynpf.fields.layout import Layout
from dynpf.types import FloatArray, NonNegative, Positive
from dynpf_systems.parts.camera_model import Colour
from dynpf_systems.parts.messages import PartsState

__all__ = [
    "NOISE",
    "Index",
    "Noise",
    "NoiseLevel",
    "NoisyLevel",
    "PartSpec",
    "RearrangementTask",
    "discs_of",
    "layout_of",
    "task_of",
    "walls_of",
]

Point = tuple[float, float]
Index = Annotated[int, Meta(ge=0, lt=64)]
NoisyLevel = Literal["low", "medium", "high"]
NoiseLevel = Literal["none", NoisyLevel]


class Noise(NamedTuple):
    """Variances of each coordinate in m^2: of the robot's motion in a tick, and of measured positions."""

    process: float
    measurement: float


NOISE: dict[NoiseLevel, Noise] = {
    "none": Noise(0.0, 0.0),
    "low": Noise(0.06e-4, 0.2e-4),
    "medium": Noise(0.06e-4, 1.0e-4),
    "high": Noise(0.06e-4, 5.0e-4),
}
"""The noise levels of PARTS chapter 4."""


class PartSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A disc to be moved; metres."""

    radius: Positive
    goal: Point
    start: Point | None = None  # None: drawn by the seed
    colour: Colour | None = None  # blue, green, red; absent: that of all parts, by which nothing is told apart


class RearrangementTask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """PARTS: a disc robot brings disc parts to their goals in a rectangle centred at the origin; metres."""

    parts: Annotated[tuple[PartSpec, ...], Meta(min_length=1, max_length=64)]
    width: Positive = 2.0
    height: Positive = 2.0
    robot_radius: Positive = 0.10
    robot_start: Point | None = None  # None: drawn by the seed
    robot_colour: Colour | None = None  # as of parts
    reach: NonNegative = 0.01  # gap between robot and held part
    # Variances of the motion, 0.06 cm^2, and of measured positions, 0.2, 1 or 5 cm^2; other tables may override them.
    noise: NoiseLevel = "low"
    # Parts that may lie in each other's goals, as lists of their indices: [[0, 3]].
    interchangeable: tuple[tuple[Index, ...], ...] = ()

    def __post_init__(self) -> None:
        """Refuse groups with parts that do not exist, or in which a part is twice: ValueError."""
        named = [part for group in self.interchangeable for part in group]
        for part in named:
            if part >= len(self.parts):
                raise ValueError(f"interchangeable: part {part}; the task has parts 0 to {len(self.parts) - 1}")
            if named.count(part) > 1:
                raise ValueError(f"interchangeable: part {part} twice; expected each part in one group at most")

    @property
    def colours(self) -> tuple[Colour | None, ...]:
        """The colours of the robot and of the parts, where they are given."""
        return (self.robot_colour, *(part.colour for part in self.parts))

    @property
    def kinds(self) -> NDArray[np.intp]:
        """The parts' kinds, (p,): those of the same kind are interchangeable."""
        kinds = np.arange(len(self.parts))
        for group in self.interchangeable:
            kinds[list(group)] = min(group, default=0)
        return kinds

    @property
    def variances(self) -> Noise:
        """The variances of the task's noise level."""
        return NOISE[self.noise]


def task_of(context: Context) -> RearrangementTask:
    """Return the task of a run; raises ScenarioError where it has none."""
    task: RearrangementTask | None = context.fact("task")
    if task is None:
        raise ScenarioError(f"{context.name}: needs the table [task] with the parts and their goals")
    return task


def layout_of(task: RearrangementTask) -> Layout:
    """Return the fixed facts of a task as the arrays that the algorithms take."""
    return Layout(
        radii=np.array([part.radius for part in task.parts]),
        goals=np.array([part.goal for part in task.parts]),
        half_size=np.array([task.width, task.height]) / 2.0,
        robot_radius=task.robot_radius,
        reach=task.reach,
    )


def walls_of(task: RearrangementTask) -> FloatArray:
    """Return the walls of a task's workspace, (4, 4): x1, y1, x2, y2; metres."""
    x, y = task.width / 2, task.height / 2
    return np.array([(-x, -y, x, -y), (x, -y, x, y), (x, y, -x, y), (-x, y, -x, -y)])


def discs_of(state: PartsState) -> FloatArray:
    """Return the parts as discs, (p, 3): x, y, radius; metres."""
    return np.array([(part.x, part.y, part.radius) for part in state.parts]).reshape(-1, 3)
