"""The waypoint controller: drives to the waypoints in order, by the estimated pose."""

from dynpf_protocol.messages import Command, Estimate
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context

from dynpf.portable import dist
from dynpf_systems.rooms.config import WaypointsConfig
from dynpf_systems.rooms.steering import steer

__all__ = ["WaypointController", "build"]


class WaypointController:
    """Heading control with limits (``steer``), by the estimate.

    Sends one command of mode "drive", with vx the forward speed, for each step with an estimate.
    """

    def __init__(self, *, config: WaypointsConfig, name: str = "controller") -> None:
        self.name = name
        self.config = config
        self._reached = 0
        self._stamp_ns = -1

    def step(self, step: Step) -> Result:
        """Return the command towards the next waypoint, or the end of the run after the last."""
        estimate = self._newest(step)
        if estimate is None:
            return Result()
        pose, waypoint = (estimate.x, estimate.y, estimate.theta), self.config.waypoint(self._reached)
        if waypoint is not None and dist(pose[:2], waypoint) <= self.config.arrival_radius:
            self._reached += 1
            waypoint = self.config.waypoint(self._reached)
        if waypoint is None:
            return Result((Output("controller/command", Command(finished=True)),))
        v, w = steer(self.config, pose, waypoint)
        return Result((Output("controller/command", Command(vx=v, w=w)),))

    def _newest(self, step: Step) -> Estimate | None:
        newest = None
        for received in step.inputs:
            if isinstance(received.message, Estimate) and received.stamp_ns >= self._stamp_ns:
                newest, self._stamp_ns = received.message, received.stamp_ns
        return newest

    def freeze(self) -> State:
        """Return the number of waypoints reached."""
        return {"reached": self._reached, "stamp_ns": self._stamp_ns}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self._reached = state["reached"]
        self._stamp_ns = state["stamp_ns"]


def build(config: WaypointsConfig, context: Context) -> WaypointController:
    """Return the controller of a run."""
    return WaypointController(config=config, name=context.name)
