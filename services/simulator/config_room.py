"""Configuration of the room simulator; SI units and radians."""

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["RoomConfig"]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]


class RoomConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="room"):
    """A unicycle robot in a rectangular room centred at the origin.

    ``alpha`` are the six error parameters of the velocity motion model (INDOOR): the true speed and turning rate differ
    from the commanded ones with variance alpha1 v^2 + alpha2 w^2 and alpha3 v^2 + alpha4 w^2, and the robot turns on
    the spot besides at a rate of variance alpha5 v^2 + alpha6 w^2.
    """

    width: Positive = 6.0  # m
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
