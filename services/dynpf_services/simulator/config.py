"""What a scenario says about the simulated world, in the table ``[simulator]``; SI units and radians."""

from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf_services.steering import Route
from dynpf_services.world.camera import CameraParams

__all__ = [
    "CapsuleConfig",
    "Door",
    "Driver",
    "Hiding",
    "Intervention",
    "PeopleParams",
    "RoomConfig",
    "WorkspaceConfig",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]


Index = Annotated[int, Meta(ge=0, lt=64)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]


class Intervention(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Someone puts a part elsewhere, out of the gripper if need be."""

    tick: Annotated[int, Meta(ge=1)]
    part: Index  # its place in the task's list, from 0
    to: tuple[float, float]  # m


class Hiding(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something covers a part: neither the camera nor the overhead sensor sees it."""

    tick: Annotated[int, Meta(ge=0)]  # the first
    ticks: Annotated[int, Meta(ge=1)]  # how many
    part: Index  # its place in the task's list, from 0


class WorkspaceConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="workspace"
):
    """A disc robot with a gripper among disc parts."""

    # m^2 a tick and coordinate, of the robot's motion; absent: that of the task's noise, 0.06 cm^2.
    process_variance: NonNegative | None = None
    grip_tolerance: NonNegative = 0.01  # gap beyond the reach at which the jaws still catch a part
    grip_angle: Positive = 0.2  # the same for the direction
    slip_probability: Probability = 0.0  # that a part slips out of the jaws as they close on it ...
    slip_distance: NonNegative = 0.03  # ... this far ahead, if there is room
    interventions: tuple[Intervention, ...] = ()  # parts that someone moves
    hidings: tuple[Hiding, ...] = ()  # parts that something covers
    start_gap: NonNegative = 0.26  # between drawn starts: the robot fits between any two parts
    start_wall_gap: NonNegative = 0.10  # between drawn starts and the walls
    camera: CameraParams | None = None  # the overhead camera; absent: no frames are rendered


class PeopleParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """People who walk through the room, and through the beams, from one place in view to the next."""

    number: Annotated[int, Meta(ge=0, le=256)] = 0
    speed: Positive = 0.8  # m/s
    radius: Positive = 0.2  # m


class Door(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A door that is in no map: while it is closed, a wall between two points."""

    segment: tuple[float, float, float, float]  # x1, y1, x2, y2 in m
    period: Positive = 20.0  # s from opening to opening
    open_for: NonNegative = 10.0  # s; at the start of each period
    phase: float = 0.0  # s after the start of the run at which a period begins
    opens_within: NonNegative = 0.0  # m from the robot: then it is open in any case


class Driver(Route, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Somebody who sees the robot and drives it, as logs are recorded: the way does not depend on an estimate.

    Stops before people and closed doors. The run ends with the route.
    """

    gap: Positive = 0.3  # m that is kept to what stands in the way ahead


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


class CapsuleConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="capsule"
):
    """A capsule that is driven along its route through the tube of the table ``[colon]``, a motion a tick.

    One that moves with noise is steered: each motion heads for the route's next place from where the capsule is.
    """

    sigma_px: NonNegative = 0.0  # px a motion, of x and of y
    sigma_theta: NonNegative = 0.0  # rad a motion
