"""What of a drawing is the inside of a tube, and whether a route fits into it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import hypot, whole
from dynpf.types import FloatArray, Floats

__all__ = ["bore"]


def bore(grid: OccupancyGrid, route: Floats, name: str = "map", specks: int = 50) -> OccupancyGrid:
    """Return the map that is free inside the tube around a route and occupied everywhere else.

    ``route``: poses (3, T) or positions (2, T), joined by straight lines. Dark spots of fewer than ``specks`` cells are
    dirt, not walls. Cells that touch at a corner only do not lead from one to the other.

    Raises ValueError, beginning with ``name``, where nothing is free, the route leaves the map or meets a wall, or the
    tube is not closed: its inside reaches the border of the map.
    """
    free = grid.free | _specks(grid.occupied, specks)
    if not free.any():
        raise ValueError(f"{name}: no free space in {grid.cells.shape[1]} x {grid.cells.shape[0]} cells")
    height, width = free.shape
    _, labels = cv2.connectedComponents(free.astype(np.uint8, casting="safe"), connectivity=4)
    x, y = _points_along(route, 0.5 * grid.resolution, 2 * (height + width))
    columns, rows = (whole(np.floor(cells), -1, max(free.shape)) for cells in grid.to_cells(x, y))
    outside = (columns < 0) | (columns >= width) | (rows < 0) | (rows >= height)
    if outside.any():
        place = _place(x, y, outside)
        raise ValueError(f"{name}: the route comes to {place}, outside of the map's {width} x {height} cells")
    blocked = ~free[rows, columns] | (labels[rows, columns] != labels[rows[0], columns[0]])
    if blocked.any():
        raise ValueError(f"{name}: the route meets a wall at {_place(x, y, blocked)}")
    inside: NDArray[np.bool_] = labels == labels[rows[0], columns[0]]
    edges = inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any()
    if edges:
        raise ValueError(f"{name}: the tube around the route is not closed: its inside reaches the border of the map")
    return OccupancyGrid.from_bools(~inside, grid.resolution, grid.origin)


def _specks(occupied: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """Return where walls belong to spots, joined at sides or corners, of fewer than ``size`` cells."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(occupied.astype(np.uint8, casting="safe"), connectivity=8)
    small = stats[:, cv2.CC_STAT_AREA] < size
    small[0] = False
    specks: NDArray[np.bool_] = small[labels]
    return specks


def _points_along(route: Floats, spacing: float, most: int) -> tuple[FloatArray, FloatArray]:
    """Return x and y of points along a route, its own among them, no farther apart than ``spacing``.

    A piece of the route has at most ``most`` of them, as many as fit into the map.
    """
    lengths = hypot(np.diff(route[0]), np.diff(route[1]))
    counts = whole(np.ceil(lengths / spacing), 0, most) + 1
    pieces = [np.linspace(route[:2, i], route[:2, i + 1], count) for i, count in enumerate(counts)]
    x, y = np.concatenate([route[:2, :1].T, *pieces]).T
    return x, y


def _place(x: FloatArray, y: FloatArray, where: NDArray[np.bool_]) -> str:
    first = int(where.argmax())
    return f"({x[first]:.0f}, {y[first]:.0f})"
