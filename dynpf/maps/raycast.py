"""Rays through an occupancy grid: how far it is to the first occupied cell, exactly."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.types import Float32s

__all__ = ["RayCaster"]


class RayCaster:
    """Casts rays in a grid. Occupied cells stop them; free and unknown ones do not, nor does the world outside.

    Holds eight tables of one byte a cell, made when the caster is (see dynpf.kernels.rays).

    ``tables``, ``size`` (width and height in cells) and ``frame`` are what the kernels take.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        """Make the tables; raises ValueError for a grid of more cells than a 32-bit index can tell apart."""
        self.grid = grid
        self.size = (grid.cells.shape[1], grid.cells.shape[0])
        self.tables = _tables(grid.occupied.view(np.uint8))
        column, row = grid.to_cells(0.0, 0.0)
        self.frame = np.array([-grid.origin[2], column, row, 1.0 / grid.resolution], dtype=np.float32)

    def ranges(self, x: ArrayLike, y: ArrayLike, angles: ArrayLike, range_max: float) -> Float32s:
        """Return the distances (N,) in metres from (x, y), in the map's frame, to where rays first enter a wall.

        That is 0 from within an occupied cell, and ``range_max`` where there is no wall up to there: also for a ray
        whose origin or angle is not a finite number. An origin on the border of two cells lies in the one that its ray
        heads for. Angles in radians, below 8000. In float32: a ray that passes a corner of a cell within about 1e-3
        cells may take either side of it. Raises ValueError where the arrays are not of one shape (N,), or
        ``range_max`` is not positive.
        """
        origins_x, origins_y, directions = (np.ascontiguousarray(a, dtype=np.float32) for a in (x, y, angles))
        if origins_x.ndim != 1 or not origins_x.shape == origins_y.shape == directions.shape:
            shapes = f"{origins_x.shape}, {origins_y.shape} and {directions.shape}"
            raise ValueError(f"RayCaster.ranges: x, y and angles of shapes {shapes} must have one shape (N,)")
        if math.isnan(range_max) or range_max <= 0.0:
            raise ValueError(f"RayCaster.ranges: range_max = {range_max} must be above 0")
        out = np.empty(origins_x.size, dtype=np.float32)
        kernels.rays.cast(origins_x, origins_y, directions, self.tables, self.size, self.frame, float(range_max), out)
        return out


def _tables(occupied: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the cones of the grid turned each way: index 4 transposes it, then 2 reverses columns and 1 rows."""
    height, width = occupied.shape
    # The last byte of a table stays zero, as a wall does: where the kernels keep rays that have come to rest.
    table_size = max((height + 2) * width, (width + 2) * height) + 1
    if 8 * table_size >= 2**31:
        raise ValueError(f"RayCaster: a grid of {width} x {height} cells is too large, the limit is about 2.6e8 cells")
    tables = np.zeros((8, table_size), dtype=np.uint8)
    for index, table in enumerate(tables):
        turned = occupied.T if index & 4 else occupied
        turned = turned[:, ::-1] if index & 2 else turned
        turned = turned[::-1] if index & 1 else turned
        kernels.rays.fill_cones(np.ascontiguousarray(turned), table[: (turned.shape[0] + 2) * turned.shape[1]])
    return tables
