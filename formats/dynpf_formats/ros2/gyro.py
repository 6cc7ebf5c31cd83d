"""A rate gyro's turns in the place of the wheels': distances are the wheels', headings the integral of the rate."""

from dynpf_formats.importers.poses import Pose, compose, relative

__all__ = ["GyroHeading"]

_LONGEST_NS = 200_000_000  # between two rates; over a longer pause the wheels' turn counts
_AHEAD_NS = 50_000_000  # how far from the newest rate a pose may be
_STILL = 1e-6  # m and rad between two poses of wheels that stand


class GyroHeading:
    """Odometry's poses with headings by a gyro, in the frame of the first pose.

    The rate is the straight line between two readings. Its bias is the mean while the wheels stand. Where no rates are,
    the turn is the wheels'.
    """

    def __init__(self) -> None:
        self._stamp_ns: int | None = None  # of the newest rate
        self._rate = self._angle = 0.0
        self._breaks = 0  # pauses so far
        self._last: tuple[int, Pose, Pose, float | None, int] | None = None
        self._bias, self._stood_s = 0.0, 0.0

    def take(self, stamp_ns: int, rate: float) -> None:
        """Take a turning rate about the robot's vertical axis, rad/s; left is positive."""
        if self._stamp_ns is not None and 0 <= stamp_ns - self._stamp_ns <= _LONGEST_NS:
            self._angle += 0.5 * (self._rate + rate) * (stamp_ns - self._stamp_ns) * 1e-9
        else:
            self._breaks += 1
        self._stamp_ns, self._rate = stamp_ns, rate

    def corrected(self, stamp_ns: int, wheels: Pose) -> Pose:
        """Return the pose for one by the wheels."""
        angle, breaks, pose = self._angle_at(stamp_ns), self._breaks, wheels
        if self._last is not None:
            last_ns, last_wheels, last_pose, last_angle, last_breaks = self._last
            dx, dy, turn = relative(last_wheels, wheels)
            if angle is not None and last_angle is not None and breaks == last_breaks:
                by_gyro = self._unbiased(
                    angle - last_angle, (stamp_ns - last_ns) * 1e-9, max(abs(dx), abs(dy), abs(turn))
                )
                dx, dy, _ = compose((0.0, 0.0, (by_gyro - turn) / 2), (dx, dy, 0.0))  # the chord of the other arc
                turn = by_gyro
            pose = compose(last_pose, (dx, dy, turn))
        self._last = (stamp_ns, wheels, pose, angle, breaks)
        return pose

    def _angle_at(self, stamp_ns: int) -> float | None:
        if self._stamp_ns is None or abs(stamp_ns - self._stamp_ns) > _AHEAD_NS:
            return None
        return self._angle + self._rate * (stamp_ns - self._stamp_ns) * 1e-9

    def _unbiased(self, turn: float, seconds: float, moved: float) -> float:
        if moved > _STILL or seconds <= 0.0:
            return turn - self._bias * seconds
        self._stood_s += seconds
        self._bias += (turn / seconds - self._bias) * seconds / self._stood_s
        return 0.0
