"""Heading control of a unicycle robot towards a waypoint, from the true pose or the estimated one."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf.portable import atan2, cos
from dynpf.types import Count, Positive

__all__ = ["Route", "steer"]


class Route(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Drive through ``points`` in order, ``laps`` times."""

    points: Annotated[tuple[tuple[float, float], ...], Meta(min_length=1, max_length=10_000)]  # m
    laps: Count = 1
    arrival_radius: Positive = 0.15  # m; a waypoint counts as reached within it
    speed: Positive = 0.3  # m/s, straight ahead
    turn_rate: Positive = 1.0  # rad/s, the fastest turn
    gain: Positive = 2.0  # 1/s, turning rate per radian of heading error

    def waypoint(self, reached: int) -> tuple[float, float] | None:
        """Return the next waypoint after ``reached`` ones, or None at the end."""
        return self.points[reached % len(self.points)] if reached < self.laps * len(self.points) else None


def steer(route: Route, pose: tuple[float, float, float], waypoint: tuple[float, float]) -> tuple[float, float]:
    """Return forward speed and turning rate towards a waypoint; the speed falls with the heading error.

    The robot turns on the spot when the waypoint is abeam or behind, so that it never circles around a waypoint.
    """
    x, y, theta = pose
    error = math.remainder(atan2(waypoint[1] - y, waypoint[0] - x) - theta, math.tau)
    turn = max(-route.turn_rate, min(route.turn_rate, route.gain * error))
    return route.speed * max(0.0, cos(error)), turn
