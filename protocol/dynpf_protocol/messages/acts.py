"""A person's acts on a simulated world, which enter it at the source's next tick."""

from typing import Annotated, Literal

from msgspec import Meta

from dynpf_protocol.messages.base import Angle, Message

__all__ = ["Drive", "HoldMap", "Move", "Place", "PlaceBody", "SetDoor"]

Coordinate = Annotated[float, Meta(ge=-1e7, le=1e7)]
Speed = Annotated[float, Meta(ge=-100.0, le=100.0)]
Index = Annotated[int, Meta(ge=0, lt=1024)]


class Drive(Message, frozen=True, kw_only=True):
    """A robot that drives is driven by hand; after ``lasts_s`` its controller, or its driver, has it again."""

    schema_name = "dynpf.Drive"
    v: Speed = 0.0  # m/s, forward
    w: Speed = 0.0  # rad/s
    lasts_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 0.5  # s of logical time


class Move(Message, frozen=True, kw_only=True):
    """A robot that moves in any direction is moved by hand along the axes of the map, as ``Drive`` does it."""

    schema_name = "dynpf.Move"
    vx: Speed = 0.0  # m/s
    vy: Speed = 0.0  # m/s
    w: Speed = 0.0  # rad/s
    lasts_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 0.5  # s of logical time


class Place(Message, frozen=True, kw_only=True):
    """The robot is carried to another pose at once; no sensor of its own feels it."""

    schema_name = "dynpf.Place"
    x: Coordinate  # m, or the unit of its true pose
    y: Coordinate  # m, or the unit of its true pose
    theta: Angle  # rad


class PlaceBody(Message, frozen=True, kw_only=True):
    """A body beside the robot, such as a part, is put elsewhere at once."""

    schema_name = "dynpf.PlaceBody"
    body: Index  # its number, from 0 on
    x: Coordinate  # m
    y: Coordinate  # m


class SetDoor(Message, frozen=True, kw_only=True):
    """A door is opened, closed, or left to open and close as the scenario has it."""

    schema_name = "dynpf.SetDoor"
    door: Index  # its number, from 0 on
    to: Literal["open", "closed", "scheduled"]


class HoldMap(Message, frozen=True, kw_only=True):
    """Another of the maps that a changing world has holds from now on; "" is the one that the scenario has then."""

    schema_name = "dynpf.HoldMap"
    map: Annotated[str, Meta(max_length=64)]
