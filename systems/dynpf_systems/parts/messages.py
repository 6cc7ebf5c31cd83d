"""Messages of PARTS: parts, detected discs, and the gripper."""

from typing import Annotated, Literal

from dynpf_protocol.messages.base import Angle, Count, Message, NonNegative, Piece, Positive
from msgspec import UNSET, Meta, UnsetType

__all__ = [
    "Detection",
    "Detections",
    "Gripper",
    "Identities",
    "Mode",
    "PartEstimate",
    "PartState",
    "PartsCommand",
    "PartsEstimate",
    "PartsState",
]

Mode = Literal["idle", "mate", "move", "leave", "look", "undecided"]
Levels = Annotated[tuple[float, ...], Meta(min_length=3, max_length=3)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]


class PartState(Piece, frozen=True, kw_only=True):
    """The true state of a part, and its goal."""

    x: float  # m
    y: float  # m
    radius: Positive  # m
    goal_x: float  # m
    goal_y: float  # m


class PartsState(Message, frozen=True, kw_only=True):
    """The true state of every part; ``held`` is the index of the part in the gripper, or -1."""

    schema_name = "dynpf.PartsState"
    parts: Annotated[tuple[PartState, ...], Meta(max_length=64)]
    held: Annotated[int, Meta(ge=-1, lt=64)]
    contacts: Count  # ticks so far in which two discs, or a disc and a wall, overlapped
    finished: bool  # the controller has finished the task
    hidden: Annotated[tuple[Annotated[int, Meta(ge=0, lt=64)], ...], Meta(max_length=64)] = ()  # seen by no camera


class Detection(Piece, frozen=True, kw_only=True):
    """A disc in workspace coordinates; ``grey`` is its median grey level minus the background's."""

    x: float  # m
    y: float  # m
    radius: Positive  # m
    grey: float  # grey levels, 0 to 255, less the background's
    residual: NonNegative = 0.0  # m, RMS distance of the edge points from the fitted circle
    colour: Levels | UnsetType = UNSET  # median blue, green, red; left out where none is asked for


class Detections(Message, frozen=True, kw_only=True):
    """The discs detected in a frame."""

    schema_name = "dynpf.Detections"
    discs: Annotated[tuple[Detection, ...], Meta(max_length=256)]


class Gripper(Message, frozen=True, kw_only=True):
    """The gripper's sensors: contact switch and angle encoder (rad, from the x axis of the workspace)."""

    schema_name = "dynpf.Gripper"
    contact: bool
    theta: Angle  # rad


class PartEstimate(Piece, frozen=True, kw_only=True):
    """The estimated position of a part."""

    x: float  # m
    y: float  # m
    variance: NonNegative  # of each coordinate, m^2
    seen: bool  # a detection was associated in this step


class PartsEstimate(Message, frozen=True, kw_only=True):
    """The estimates of all parts; the robot's estimate has the same stamp."""

    schema_name = "dynpf.PartsEstimate"
    parts: Annotated[tuple[PartEstimate, ...], Meta(max_length=64)]
    held: Annotated[int, Meta(ge=-1, lt=64)]  # index of the part in the gripper, or -1


class Identities(Message, frozen=True, kw_only=True):
    """How sure it is who is who: probabilities that the discs taken for the robot and the parts are these.

    A part's disc may as well be that of a part with which it is interchangeable. ``robot_among`` are the indices of the
    parts whose disc may be the robot instead.
    """

    schema_name = "dynpf.Identities"
    robot: Share
    parts: Annotated[tuple[Share, ...], Meta(max_length=64)]
    robot_among: Annotated[tuple[Annotated[int, Meta(ge=0, lt=64)], ...], Meta(max_length=64)] = ()


class PartsCommand(Message, frozen=True, kw_only=True):
    """The command of the gripper until the next one, and the current subtask: its part and stage.

    In the mode "look" the robot moves to find out which disc it is. "undecided" ends the run: which part is which is
    not known, and nothing else is left to do.
    """

    schema_name = "dynpf.PartsCommand"
    mode: Mode
    target: Annotated[int, Meta(ge=-1, lt=64)] = -1  # index of the part, or -1
    grip: bool = False
