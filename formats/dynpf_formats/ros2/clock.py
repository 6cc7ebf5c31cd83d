"""The clock of a live robot: stamps that jump, as a simulator's clock does or one that is set, become a run's time."""

from typing import NamedTuple

__all__ = ["RobotClock", "Told"]

JUMP_NS = 2 * 10**9  # a stamp this far from where the last one would be by now is a jump
AGREE_NS = 10**9


class Told(NamedTuple):
    """The time of a record in the run, ns, and whether the clock has jumped before it."""

    stamp_ns: int
    jumped: bool


class RobotClock:
    """Turns the stamps of a robot's messages into the times of a run, which goes on when they jump.

    One stamp that is far from the others is wrong, and its message is left out. If the next message agrees with it, the
    robot's clock has jumped: the run's time goes on by the time of arrival, and later stamps keep that distance.
    """

    def __init__(self) -> None:
        self._ahead_ns: int | None = None  # how far the last good stamp was ahead of its arrival
        self._doubtful_ns: int | None = None
        self._offset_ns = 0  # of the run's time to the robot's

    def take(self, stamp_ns: int, arrival_ns: int) -> Told | None:
        """Return the time of a message that has arrived at ``arrival_ns``; None if its stamp is doubtful."""
        ahead_ns = stamp_ns - arrival_ns
        jumped = False
        if self._ahead_ns is not None and abs(ahead_ns - self._ahead_ns) > JUMP_NS:
            if self._doubtful_ns is None or abs(ahead_ns - self._doubtful_ns) > AGREE_NS:
                self._doubtful_ns = ahead_ns
                return None
            self._offset_ns -= ahead_ns - self._ahead_ns
            jumped = True
        self._ahead_ns, self._doubtful_ns = ahead_ns, None
        told_ns = stamp_ns + self._offset_ns
        return Told(told_ns, jumped) if told_ns >= 0 else None

    def now_ns(self, arrival_ns: int) -> int | None:
        """Return the time of the run at a time of arrival; None before the first stamp."""
        return None if self._ahead_ns is None else max(arrival_ns + self._ahead_ns + self._offset_ns, 0)

    def robot_ns(self, stamp_ns: int) -> int:
        """Return the robot's time of a time in the run."""
        return max(stamp_ns - self._offset_ns, 0)
