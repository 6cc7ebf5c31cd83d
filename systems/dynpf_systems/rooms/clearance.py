"""Distance to the nearest wall of a map."""

import math
from collections.abc import Callable

import numpy as np

from dynpf import kernels
from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.types import FloatArray
from dynpf_systems.rooms.maps import Maps

__all__ = ["Clearance", "clearance_of", "from_segments"]

Clearance = Callable[[float, float], float]
"""The distance in metres from a point to the nearest wall."""


def clearance_of(maps: Maps) -> Clearance | None:
    """Return the clearance in a run's map, or None without a map."""
    if maps.segments is not None:
        return from_segments(maps.segments.segments)
    return None if maps.grid is None else _from_grid(maps.grid)


def from_segments(segments: FloatArray) -> Clearance:
    """Return the clearance among segments (S, 4), infinite where there are none."""
    walls = np.array(segments, dtype=np.float64)

    def clearance(x: float, y: float) -> float:
        """Return the distance to the nearest wall, m."""
        return float(kernels.clearance.to_segments(float(x), float(y), walls))

    return clearance


def _from_grid(grid: OccupancyGrid) -> Clearance:
    field = distance_field(grid.occupied, grid.resolution)
    rows, columns = field.shape

    def clearance(x: float, y: float) -> float:
        """Return the distance to the nearest wall, m."""
        column, row = (math.floor(cell) for cell in grid.to_cells(x, y))
        return float(field[row, column]) if 0 <= column < columns and 0 <= row < rows else 0.0

    return clearance
