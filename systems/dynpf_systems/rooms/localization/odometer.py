"""Odometry over time: twists with their durations, measured displacements, and dead reckoning."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from dynpf_protocol.messages import Odometry, OdometryPose
from dynpf_runtime.node import State

from dynpf.motion.model import Displacement, Twist
from dynpf.portable import hypot
from dynpf.se2 import arc_displacement, compose, relative
from dynpf.types import FloatArray
from dynpf_systems.rooms.localization.components import Moved
from dynpf_systems.rooms.localization.gate import Gate

__all__ = ["Odometer"]

NANOSECONDS = 10**9
SHORTEST_NS = NANOSECONDS // 1000  # the least duration of a displacement


class _Velocity(NamedTuple):
    """The twist in force: m/s and rad/s."""

    v: float
    w: float


class _TimedTwist(NamedTuple):
    """A twist that holds from ``from_ns`` on."""

    from_ns: int
    v: float
    w: float


class Odometer:
    """The clock of an estimator, and the robot's motion by odometry up to the current time.

    A twist holds from ``delay_s`` after its message until the next; a twist overtaken by a newer message is dropped.
    Odometry given as poses moves the robot from pose to pose, whatever their stamps. What no robot can have driven is
    left out, see Gate. ``before_moving`` is called before each movement, while the clock still has the earlier time.
    ``reckoned`` is the pose (3,) by dead reckoning, None without a start.
    """

    def __init__(self, delay_s: float, start: FloatArray | None, before_moving: Callable[[], None]) -> None:
        self._delay_ns = round(delay_s * NANOSECONDS)
        self._before_moving = before_moving
        self.reckoned = start
        self.stamp_ns: int | None = None
        self._twist = _Velocity(0.0, 0.0)
        self._coming: list[_TimedTwist] = []
        self._newest_ns = -1
        self._pose: FloatArray | None = None
        self._gate = Gate()
        self._held: list[Twist | Moved] = []  # not yet handed out; empty between steps
        self._since: tuple[float, float] | None = None  # distance and turn released since the last mark

    @property
    def left_out(self) -> int:
        """The number of messages that were not believed."""
        return self._gate.left_out

    def take(self, stamp_ns: int, message: Odometry | OdometryPose) -> None:
        """Take in a message of odometry."""
        match message:
            case Odometry(v=v, w=w):
                if self._gate.twist(v, w) and stamp_ns >= self._newest_ns:
                    self._newest_ns = stamp_ns
                    self._coming.append(_TimedTwist(stamp_ns + self._delay_ns, v, w))
                    self.advance(stamp_ns)
            case OdometryPose(x=x, y=y, theta=theta):
                self._move(stamp_ns, np.array([x, y, theta]))

    def advance(self, stamp_ns: int) -> None:
        """Advance the clock to ``stamp_ns``, through every change of twist before it."""
        if self.stamp_ns is None:
            self.stamp_ns = stamp_ns
        while self._coming and self._coming[0].from_ns <= max(stamp_ns, self.stamp_ns):
            change = self._coming.pop(0)
            self._hold(change.from_ns)
            self._twist = _Velocity(change.v, change.w)
        self._hold(stamp_ns)

    def release(self) -> list[Twist | Moved]:
        """Return the motion since the last release."""
        if self._since is not None:
            self._since = self.travelled
        held, self._held = self._held, []
        return held

    def mark(self) -> None:
        """Count distance and turn from here on."""
        self._since = (0.0, 0.0)

    def forget_distance(self) -> None:
        """Count as before the first mark."""
        self._since = None

    @property
    def travelled(self) -> tuple[float, float] | None:
        """Distance (m) and turn (rad) since the last mark, as sums of absolute values; None before the first mark."""
        if self._since is None:
            return None
        travel, turn = self._since
        for held in self._held:
            if isinstance(held, Twist):
                way, angle = held.v * held.duration, held.w * held.duration
            else:
                way, angle = hypot(held.displacement.dx, held.displacement.dy), held.displacement.turn
            travel, turn = travel + abs(way), turn + abs(angle)
        return travel, turn

    def freeze(self) -> State:
        """Return the clock, the twists in force and to come, the last pose, the distance, and dead reckoning."""
        return {
            "reckoned": self.reckoned,
            "stamp_ns": self.stamp_ns,
            "twist": list(self._twist),
            "coming": [list(twist) for twist in self._coming],
            "newest_ns": self._newest_ns,
            "pose": self._pose,
            "since": None if self._since is None else list(self._since),
            **self._gate.freeze(),
        }

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        self.reckoned, self._pose = (
            None if state[name] is None else np.array(state[name]) for name in ("reckoned", "pose")
        )
        self.stamp_ns, self._newest_ns = state["stamp_ns"], state["newest_ns"]
        self._twist = _Velocity(*state["twist"])
        self._coming = [_TimedTwist(*twist) for twist in state["coming"]]
        self._gate.thaw(state)
        since = state["since"]
        self._since = None if since is None else (since[0], since[1])

    def _move(self, stamp_ns: int, pose: FloatArray) -> None:
        """Move from the last pose of odometry to ``pose``."""
        verdict = self._gate.pose(self._pose, pose, (stamp_ns - self._newest_ns) / NANOSECONDS)
        if not verdict.believed:
            return
        start, self._pose = verdict.since, pose
        since_ns, self._newest_ns = self._newest_ns, max(stamp_ns, self._newest_ns)
        if start is None:
            return
        self._before_moving()
        step = relative(start, pose)
        duration_ns = max(self._newest_ns - since_ns, SHORTEST_NS)
        self._held.append(Moved(Displacement(*step.tolist()), duration_ns / NANOSECONDS))
        if self.reckoned is not None:
            self.reckoned = compose(self.reckoned, step)

    def _hold(self, stamp_ns: int) -> None:
        """Apply the twist in force up to ``stamp_ns``."""
        assert self.stamp_ns is not None
        duration = (stamp_ns - self.stamp_ns) / NANOSECONDS
        if duration <= 0.0:
            return
        self._before_moving()
        self.stamp_ns = stamp_ns
        if self._pose is not None:
            return  # poses give the motion
        v, w = self._twist
        last = self._held[-1] if self._held else None
        if isinstance(last, Twist) and last[:2] == (v, w):
            self._held[-1] = Twist(v, w, last.duration + duration)
        else:
            self._held.append(Twist(v, w, duration))
        if self.reckoned is not None:
            self.reckoned = compose(self.reckoned, arc_displacement(v * duration, w * duration))
