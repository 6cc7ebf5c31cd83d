"""A scan of a laser or depth camera: ranges at known angles, taken at one instant."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.se2 import compose

__all__ = ["Scan"]


class Scan(NamedTuple):
    """B beams: ``angles`` (rad, anticlockwise from the sensor's axis) and ``ranges`` (m), float32 arrays of shape (B,).

    The sensor measures between ``range_min`` and ``range_max``, metres. ``mount`` is its pose on the robot, x, y and
    theta.
    """

    angles: NDArray[np.float32]
    ranges: NDArray[np.float32]
    range_min: float
    range_max: float
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def beams(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return angles and ranges as float32; raises ValueError if they are not of one shape (B,)."""
        angles, ranges = np.asarray(self.angles, dtype=np.float32), np.asarray(self.ranges, dtype=np.float32)
        if angles.ndim != 1 or angles.shape != ranges.shape:
            raise ValueError(f"Scan: angles {angles.shape} and ranges {ranges.shape} must have one shape (B,)")
        return angles, ranges

    def mounted(self, x: float, y: float, theta: float) -> NDArray[np.float32]:
        """Return the sensor's pose on the robot, shape (3,) float32, when it is seen so from ``mount``."""
        return np.array(compose(np.array(self.mount), np.array([x, y, theta])), dtype=np.float32)

    def usable(self, max_beams: int) -> "Scan":
        """Return at most ``max_beams`` of the beams that carry information, evenly spaced among them, as float32.

        Those are the beams with an angle and a range that are numbers, no shorter than ``range_min``. A range beyond
        ``range_max``, infinity included (no return, ROS REP 117), reads ``range_max``. There may be no beam left.
        Raises ValueError as ``beams`` does, and if ``max_beams`` is less than one.
        """
        angles, ranges = self.beams()
        if max_beams < 1:
            raise ValueError(f"Scan.usable: max_beams = {max_beams} must be at least 1")
        kept = np.flatnonzero(np.isfinite(angles) & (ranges >= np.float32(self.range_min)))
        if len(kept) > max_beams:
            kept = kept[(2 * np.arange(max_beams) + 1) * len(kept) // (2 * max_beams)]
        return self._replace(angles=angles[kept], ranges=np.minimum(ranges[kept], np.float32(self.range_max)))
