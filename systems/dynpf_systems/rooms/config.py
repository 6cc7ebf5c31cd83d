"""Configuration of the simulated room and of the routes driven in it; SI units and radians."""

from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf.types import Count, NonNegative, Positive
from dynpf_systems.rooms.steering import Route

__all__ = [
    "Door",
    "Driver",
    "Kidnapping",
    "PeopleParams",
    "RoomConfig",
    "WaypointsConfig",
]


Index = Annotated[int, Meta(ge=0, lt=64)]


class PeopleParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """People who walk through the room, and through the beams, from goal to goal in view."""

    number: Annotated[int, Meta(ge=0, le=256)] = 0
    speed: Positive = 0.8  # m/s
    radius: Positive = 0.2  # m


class Door(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A door that is in no map; while closed, it is a wall between two points."""

    segment: tuple[float, float, float, float]  # x1, y1, x2, y2 in m
    period: Positive = 20.0  # s from opening to opening
    open_for: NonNegative = 10.0  # s; at the start of each period
    phase: float = 0.0  # s after the start of the run at which a period begins
    opens_within: NonNegative = 0.0  # m from the robot: then it is open in any case


class Kidnapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Someone carries the robot to another pose, within one tick; neither wheels nor gyro feel it."""

    tick: Count  # the tick in which it is there
    to: tuple[float, float, float]  # m, m, rad


class Driver(Route, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A driver who sees the robot, as when a log is recorded: the route does not depend on an estimate.

    The driver stops before people and closed doors. The run ends with the route.
    """

    gap: Positive = 0.3  # m, kept to an obstacle ahead


class RoomConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="room"):
    """A unicycle robot in a room: within the walls of the run's map, or else in a rectangle centred at the origin.

    ``alpha`` are the six error parameters of the velocity motion model (INDOOR): the true speed and turning rate differ
    from the commanded ones with variance alpha1 v^2 + alpha2 w^2 and alpha3 v^2 + alpha4 w^2, and the robot turns on
    the spot besides at a rate of variance alpha5 v^2 + alpha6 w^2.
    """

    width: Positive = 6.0  # m; of the rectangle, where there is no map
    height: Positive = 4.0  # m
    robot_radius: Positive = 0.15  # m
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad
    max_speed: Positive = 1.0  # m/s
    max_turn_rate: Positive = 2.0  # rad/s
    alpha: tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    driver: Driver | None = None  # absent: the controller drives
    people: PeopleParams | None = None
    doors: Annotated[tuple[Door, ...], Meta(max_length=256)] = ()
    kidnappings: Annotated[tuple[Kidnapping, ...], Meta(max_length=256)] = ()


class WaypointsConfig(Route, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="waypoints"):
    """Drive through ``points`` in order, ``laps`` times, by the estimated pose."""
