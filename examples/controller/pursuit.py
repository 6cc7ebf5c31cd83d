"""Pure pursuit: a controller of one's own, which steers for a point of the way that lies ahead."""

import math
from collections.abc import Iterable
from typing import Annotated, NamedTuple

from dynpf_lab import Message, Moment, Node
from dynpf_protocol.messages import Command, Estimate
from msgspec import Meta

from dynpf.portable import atan2, hypot, sin

Positive = Annotated[float, Meta(gt=0.0)]
Point = tuple[float, float]  # m


class Pursuit(Node, frozen=True, kw_only=True):
    """Follows the way through ``points``, once, at a constant speed, and ends the run."""

    reads = ("estimator/state",)
    writes = {"command": Command}  # of a node called controller: controller/command, which the robot obeys

    points: tuple[Point, ...]
    speed: Positive = 0.3  # m/s
    reached: Positive = 0.3  # m from a point, from which on the next one is steered for

    class State(NamedTuple):
        passed: int = 0  # of the points

    def step(self, state: State, moment: Moment) -> tuple[State, Iterable[Message]]:
        estimate = moment.newest(Estimate)
        if estimate is None:
            return state, ()
        if state.passed == len(self.points):
            return state, [Command(finished=True)]
        x, y = self.points[state.passed]
        ahead = hypot(x - estimate.x, y - estimate.y)
        if ahead < self.reached:
            return state._replace(passed=state.passed + 1), [Command(vx=self.speed)]
        aside = atan2(y - estimate.y, x - estimate.x) - estimate.theta
        turn = 2.0 * self.speed * sin(math.remainder(aside, math.tau)) / ahead
        return state, [Command(vx=self.speed, w=max(-1.0, min(turn, 1.0)))]
