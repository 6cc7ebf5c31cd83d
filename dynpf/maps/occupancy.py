"""A grid of cells, each free, occupied or unknown, lying somewhere in the map frame."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf.maps.distance import squared_distances
from dynpf.portable import sincos, whole
from dynpf.rng import Stream

__all__ = ["FREE", "MOST_CELLS", "OCCUPIED", "UNKNOWN", "OccupancyGrid", "check_size", "faces", "thickened"]

FREE, OCCUPIED, UNKNOWN = 0, 1, 2

MOST_CELLS = 200_000_000
"""The cells of the largest map that is made of a drawing or of segments: at 5 cm a cell, 700 m by 700 m."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Square cells of a map; two grids are equal only if they are one object.

    ``cells``: FREE, OCCUPIED or UNKNOWN, uint8 of shape (H, W), copied and then read-only. Row 0 lies at the origin and
    the row grows with y of the grid's own frame, the column with x.
    ``resolution``: side of a cell in metres.
    ``origin``: pose (x, y, yaw), metres and radians, of the outer corner of cell (0, 0) in the map frame.

    Raises ValueError where cells are not such an array of at least one cell, or a number is not finite or, for the
    resolution, not positive.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Filters that recover sample the free area at every step: its cells, by clearance, once found.
    _places: dict[float, NDArray[np.int64]] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        _check_cells(self.cells)
        if not (np.isfinite(self.resolution) and self.resolution > 0.0):
            raise ValueError(f"resolution = {self.resolution!r}; expected metres a cell, finite and above 0")
        if len(self.origin) != 3 or not np.isfinite(self.origin).all():
            raise ValueError(f"origin = {self.origin!r}; expected x, y in metres and yaw in radians, all finite")
        cells = np.array(self.cells, order="C")
        cells.flags.writeable = False
        x, y, yaw = self.origin
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "resolution", float(self.resolution))
        object.__setattr__(self, "origin", (float(x), float(y), float(yaw)))

    @classmethod
    def from_bools(
        cls, occupied: Bools, resolution: float, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> "OccupancyGrid":
        """Return the grid whose cells are occupied where ``occupied`` (H, W) is true and free elsewhere."""
        return cls(np.where(occupied, np.uint8(OCCUPIED), np.uint8(FREE)), resolution, origin)

    @property
    def occupied(self) -> Bools:
        """Where a wall is, shape (H, W)."""
        walls: Bools = self.cells == OCCUPIED
        return walls

    @property
    def free(self) -> Bools:
        """Where a robot may be, shape (H, W)."""
        free: Bools = self.cells == FREE
        return free

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres, along the grid's own axes."""
        height, width = self.cells.shape
        return width * self.resolution, height * self.resolution

    def to_cells(self, x: ArrayLike, y: ArrayLike) -> tuple[Any, Any]:
        """Return (column, row) of points of the map frame, in cells and not rounded: their floors index ``cells``.

        Cell (r, c) spans [c, c + 1) x [r, r + 1). Float64, of the shape that ``x`` and ``y`` broadcast to; outside the
        grid the numbers go on beyond it.
        """
        from_x, from_y, yaw = self.origin
        east, north = np.asarray(x, np.float64) - from_x, np.asarray(y, np.float64) - from_y
        sine, cosine = sincos(yaw)
        return (cosine * east + sine * north) / self.resolution, (cosine * north - sine * east) / self.resolution

    def to_map(self, column: ArrayLike, row: ArrayLike) -> tuple[Any, Any]:
        """Return (x, y) in metres in the map frame, the inverse of ``to_cells``; cells have their centres at halves."""
        along = np.asarray(column, np.float64) * self.resolution
        across = np.asarray(row, np.float64) * self.resolution
        from_x, from_y, yaw = self.origin
        sine, cosine = sincos(yaw)
        return from_x + cosine * along - sine * across, from_y + sine * along + cosine * across

    def sample_free(self, count: int, stream: Stream, clearance: float = 0.0) -> NDArray[np.float32]:
        """Return poses (3, count) uniform over the free area, headings uniform in [-pi, pi); a column a particle.

        With ``clearance`` in metres, only cells of which every point keeps that distance from every occupied cell.
        Positions lie in their cells up to the rounding of float32. Raises ValueError when no cell is left,
        or the clearance is no number of metres from 0 on.
        """
        if not clearance >= 0.0:
            raise ValueError(f"clearance = {clearance!r}; expected metres, not negative")
        if clearance not in self._places:
            self._places[clearance] = _free_cells(self, clearance)
        places = self._places[clearance]
        if not len(places):
            what = f" {clearance} m away from every wall" if clearance > 0.0 else ""
            raise ValueError(f"no free cell{what} in a grid of {self.cells.shape[1]} x {self.cells.shape[0]} cells")
        high, low, along, across, turn = stream.uniforms(5, count).astype(np.float64)
        # One number has 24 bits, fewer than a large map has cells; two together have 48.
        index = places[whole((high + low * 2.0**-24) * len(places), 0, len(places) - 1)]
        row, column = np.divmod(index, self.cells.shape[1])
        x, y = self.to_map(column + along, row + across)
        return np.stack((x, y, (2.0 * turn - 1.0) * np.pi)).astype(np.float32)


def check_size(width: float, height: float, most: int = MOST_CELLS) -> None:
    """Raise ValueError for a map of more than ``most`` cells, before it takes any memory."""
    if not width * height <= most:
        raise ValueError(f"a map of {width:.0f} x {height:.0f} cells; expected at most {most}")


def faces(occupied: Bools, free: Bools) -> Bools:
    """Return the occupied cells that share a side with a free one, (H, W): the faces of walls.

    What lies behind a face is never the end of a beam but by noise. Where no occupied cell is at a free one there is
    nothing to choose by: all of them are returned.
    """
    padded = np.pad(free, 1)
    seen = occupied & (padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:])
    return seen if seen.any() else occupied


def thickened(occupied: Bools) -> Bools:
    """Return where a cell or one of its eight neighbours is occupied, shape (H, W)."""
    padded = np.pad(occupied, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def _free_cells(grid: OccupancyGrid, clearance: float) -> NDArray[np.int64]:
    """Return the flat indices of the free cells that keep ``clearance`` metres from walls.

    The gap between two cells is the distance from the one's centre to the nearest centre in the 3 x 3 block about the
    other, so that the distances to thickened walls are the gaps.
    """
    free = grid.free
    if clearance > 0.0:
        gaps = squared_distances(thickened(grid.occupied))
        free &= gaps * (grid.resolution * grid.resolution) >= clearance * clearance
    return np.flatnonzero(free)


def _check_cells(cells: NDArray[np.uint8]) -> None:
    if not isinstance(cells, np.ndarray) or cells.dtype != np.uint8 or cells.ndim != 2 or not cells.size:
        what = f"{cells.dtype} of shape {cells.shape}" if isinstance(cells, np.ndarray) else type(cells).__name__
        raise ValueError(f"cells is {what}; expected a uint8 array (H, W) of at least one cell")
    if cells.max() > UNKNOWN:
        row, column = np.argwhere(cells > UNKNOWN)[0]
        raise ValueError(
            f"cells[{row}, {column}] = {cells[row, column]}; expected {FREE} (free), {OCCUPIED} (occupied) or "
            f"{UNKNOWN} (unknown)"
        )
