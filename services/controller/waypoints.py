"""The waypoint controller: heads for one waypoint after the other by the estimated pose."""

import math

from protocol.messages import Command, Estimate
from services.controller.config import WaypointsConfig
from services.node import Output, Result, State, Step

__all__ = ["WaypointController"]


class WaypointController:
    """Heading control with limits: turns towards the waypoint, the slower the more it has to turn.

    Commands mode "drive", vx being the forward speed, once for each step with an estimate. The robot turns on the spot
    when the waypoint is abeam or behind, so it never circles around one.
    """

    name = "controller"
    reads = frozenset({"estimator/state"})
    writes = frozenset({"controller/command"})

    def __init__(self, *, config: WaypointsConfig, seed: int, tick_s: float) -> None:  # noqa: ARG002 - every node is given them
        self.config = config
        self._reached = 0
        self._stamp_ns = -1

    def step(self, step: Step) -> Result:
        estimate = self._newest(step)
        if estimate is None:
            return Result()
        if not self._finished and self._distance(estimate) <= self.config.arrival_radius:
            self._reached += 1
        command = Command(mode="idle", finished=True) if self._finished else self._steer(estimate)
        return Result((Output("controller/command", command),))

    def _newest(self, step: Step) -> Estimate | None:
        newest = None
        for received in step.inputs:
            if isinstance(received.message, Estimate) and received.stamp_ns >= self._stamp_ns:
                newest, self._stamp_ns = received.message, received.stamp_ns
        return newest

    @property
    def _finished(self) -> bool:
        return self._reached >= self.config.laps * len(self.config.points)

    @property
    def _waypoint(self) -> tuple[float, float]:
        return self.config.points[self._reached % len(self.config.points)]

    def _distance(self, estimate: Estimate) -> float:
        x, y = self._waypoint
        return math.hypot(x - estimate.x, y - estimate.y)

    def _steer(self, estimate: Estimate) -> Command:
        x, y = self._waypoint
        error = math.remainder(math.atan2(y - estimate.y, x - estimate.x) - estimate.theta, math.tau)
        limit = self.config.turn_rate
        return Command(
            mode="drive",
            vx=self.config.speed * max(0.0, math.cos(error)),
            w=max(-limit, min(limit, self.config.gain * error)),
        )

    def freeze(self) -> State:
        return {"reached": self._reached, "stamp_ns": self._stamp_ns}

    def thaw(self, state: State) -> None:
        self._reached = state["reached"]
        self._stamp_ns = state["stamp_ns"]
