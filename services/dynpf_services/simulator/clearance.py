"""How far it is to the nearest wall of a map."""

import math
from collections.abc import Callable

import numpy as np

from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import norm
from dynpf.se2 import FloatArray
from dynpf_services.maps import Maps

__all__ = ["Clearance", "clearance_of", "from_segments"]

Clearance = Callable[[float, float], float]
"""The distance in metres from a point to the nearest wall."""


def clearance_of(maps: Maps) -> Clearance | None:
    """Return the clearance in a run's map, None where there is none."""
    if maps.segments is not None:
        return from_segments(maps.segments.segments)
    return None if maps.grid is None else _from_grid(maps.grid)


def from_segments(segments: FloatArray) -> Clearance:
    """Return the clearance among segments (S, 4), infinite where there are none."""
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    squared = np.sum(along * along, axis=1)

    def clearance(x: float, y: float) -> float:
        from_start = np.array([x, y]) - start
        fraction = np.clip(np.sum(from_start * along, axis=1) / squared, 0.0, 1.0)
        return float(np.min(norm(from_start - fraction[:, None] * along, axis=1), initial=np.inf))

    return clearance


def _from_grid(grid: OccupancyGrid) -> Clearance:
    field = distance_field(grid.occupied, grid.resolution)
    rows, columns = field.shape

    def clearance(x: float, y: float) -> float:
        column, row = (math.floor(place) for place in grid.to_cells(x, y))
        return float(field[row, column]) if 0 <= column < columns and 0 <= row < rows else 0.0

    return clearance
