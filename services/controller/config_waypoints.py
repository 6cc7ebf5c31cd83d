"""Configuration of the waypoint controller; SI units and radians."""

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["WaypointsConfig"]

Positive = Annotated[float, Meta(gt=0.0)]


class WaypointsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="waypoints"
):
    """Drive through ``points`` in order, ``laps`` times."""

    points: Annotated[tuple[tuple[float, float], ...], Meta(min_length=1, max_length=10_000)]  # m
    laps: Annotated[int, Meta(ge=1)] = 1
    arrival_radius: Positive = 0.15  # m; a waypoint counts as reached within it
    speed: Positive = 0.3  # m/s, straight ahead
    turn_rate: Positive = 1.0  # rad/s, the fastest turn
    gain: Positive = 2.0  # 1/s, turning rate per radian of heading error
