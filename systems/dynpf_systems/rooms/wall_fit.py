"""How well scans fit a map at given poses: the share of their beams that end near a wall."""

from collections.abc import Sequence

import numpy as np

from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.scan import Scan
from dynpf.portable import sincos, whole
from dynpf.rng import Stream
from dynpf.types import FloatArray

__all__ = ["NEAR_M", "WallFit"]

NEAR_M = 0.2
"""A beam that ends no farther than this from a wall is explained by the map, in metres."""

MOST_BEAMS = 120


class WallFit:
    """The walls of a map, and whether scans end near them: no farther than ``near`` metres."""

    def __init__(self, grid: OccupancyGrid, near: float = NEAR_M) -> None:
        self._grid = grid
        self._near = distance_field(grid.occupied, grid.resolution, 1.0) <= near

    def share(self, scans: Sequence[Scan], poses: FloatArray) -> float:
        """Return the median over scans, taken at ``poses`` (3, len(scans)), of the share of beams that end near a wall.

        Beams without return do not count. NaN where no scan has a beam with one.
        """
        shares = [self._share(scan, pose) for scan, pose in zip(scans, poses.T, strict=True)]
        known = [share for share in shares if np.isfinite(share)]
        return float(np.median(known)) if known else np.nan

    def by_chance(self, scans: Sequence[Scan]) -> float:
        """Return the share at poses drawn from the free space of the map; NaN in a map without any."""
        if not self._grid.free.any():
            return np.nan
        return self.share(scans, self._grid.sample_free(len(scans), Stream.of(1, "chance", 0)).astype(np.float64))

    def _share(self, scan: Scan, pose: FloatArray) -> float:
        beams = scan.usable(MOST_BEAMS)
        returned = beams.ranges < np.float32(scan.range_max)
        if not returned.any():
            return np.nan
        ranges, angles = beams.ranges[returned].astype(np.float64), beams.angles[returned].astype(np.float64)
        x, y, theta = (float(number) for number in scan.mounted(0.0, 0.0, 0.0))
        sine, cosine = sincos(angles + theta)
        on_robot_x, on_robot_y = x + ranges * cosine, y + ranges * sine
        turn_sine, turn_cosine = sincos(pose[2])
        column, row = self._grid.to_cells(
            pose[0] + turn_cosine * on_robot_x - turn_sine * on_robot_y,
            pose[1] + turn_sine * on_robot_x + turn_cosine * on_robot_y,
        )
        height, width = self._near.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        near = np.zeros(ranges.size, dtype=np.bool_)
        near[inside] = self._near[whole(row[inside], 0, height - 1), whole(column[inside], 0, width - 1)]
        return float(np.mean(near))
