"""What of a scan a map contradicts, and what it only does not know.

Things that are not on a map shorten beams, and beyond its edge nothing is known: neither speaks against a pose. A beam
that goes on behind a wall does, and so do many beams that end where the map has free space.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.measurement.scan import Scan
from dynpf.portable import sincos, whole
from dynpf.types import FloatArray

__all__ = ["contradicted_share"]

NEAR_M = 0.2
"""An end no farther than this from a wall is explained by the map."""

BEYOND_M = 0.4
"""A beam that goes on for more than this behind a wall has passed through it."""

FARTHEST_M = 30.0
"""Beams are followed no farther."""


def contradicted_share(
    grid: OccupancyGrid, near: NDArray[np.bool_], scan: Scan, sensor: FloatArray, max_beams: int
) -> float:
    """Return the share of a scan's beams, taken by a sensor at a pose (3,), that contradict a map; 0 without beams.

    ``near`` (H, W): the cells no farther than ``NEAR_M`` from a wall. Beams are followed in steps of a cell.
    """
    beams = scan.usable(max_beams)
    lengths = np.minimum(beams.ranges.astype(np.float64), FARTHEST_M)
    if not lengths.size:
        return 0.0
    sine, cosine = sincos(beams.angles.astype(np.float64) + sensor[2])
    steps = grid.resolution * np.arange(1 + math.ceil(float(lengths.max()) / grid.resolution))
    on_way, _ = _looked_up(grid, near, sensor, cosine[:, None] * steps, sine[:, None] * steps)
    through = ((on_way == OCCUPIED) & (steps < lengths[:, None] - BEYOND_M)).any(axis=1)
    returned = beams.ranges < np.float32(min(scan.range_max, FARTHEST_M))
    at_end, explained = _looked_up(grid, near, sensor, cosine * lengths, sine * lengths)
    return float(np.mean(through | (returned & (at_end == FREE) & ~explained)))


def _looked_up(
    grid: OccupancyGrid, near: NDArray[np.bool_], sensor: FloatArray, east: FloatArray, north: FloatArray
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return what the map has at points given from the sensor's position, and whether they are near a wall."""
    column, row = grid.to_cells(sensor[0] + east, sensor[1] + north)
    height, width = grid.cells.shape
    inside = (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
    cells = whole(row[inside], 0, height - 1), whole(column[inside], 0, width - 1)
    values = np.full(inside.shape, UNKNOWN, dtype=np.uint8)
    close = np.zeros(inside.shape, dtype=np.bool_)
    values[inside], close[inside] = grid.cells[cells], near[cells]
    return values, close
