"""Walls as line segments, and the lines that carry them in polar form (TURTLEBOT)."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynpf.maps.occupancy import MOST_CELLS, OccupancyGrid, check_size
from dynpf.portable import atan2, hypot, sincos, whole
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray

__all__ = ["SegmentMap", "polar_form", "polar_in_frame"]


class SegmentMap:
    """S straight walls, in the order given.

    ``segments``: ends x1, y1, x2, y2 in metres, shape (S, 4); ``lengths`` in metres, (S,); ``rho`` in metres and
    ``alpha`` in radians, each (S,): the polar form of the carrying lines in the map frame. All float64, read-only.
    """

    def __init__(self, segments: ArrayLike) -> None:
        """Take the ends, shape (S, 4) with S >= 1.

        Raises ValueError where the shape is another, or naming the first segment that is not finite or has no length.
        """
        self.segments: FloatArray = np.array(segments, dtype=np.float64)
        if self.segments.ndim != 2 or self.segments.shape[1] != 4 or not len(self.segments):
            raise ValueError(f"segments of shape {self.segments.shape}; expected (S, 4): x1, y1, x2, y2 of each")
        x1, y1, x2, y2 = self.segments.T
        self.lengths: FloatArray = hypot(x2 - x1, y2 - y1)
        self._refuse_where(~np.isfinite(self.segments).all(axis=1), "finite metres")
        self._refuse_where(self.lengths == 0.0, "two different ends")
        self._refuse_where(~np.isfinite(self.lengths), "a finite length")
        self.rho, self.alpha = polar_form(self.segments)
        for array in (self.segments, self.lengths, self.rho, self.alpha):
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.segments)

    def seen_from(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rho (m) and alpha (rad) of every line in the frame of every pose (3, N), each of shape (S, N)."""
        return polar_in_frame(self.rho[:, None], self.alpha[:, None], poses)

    def rasterize(self, resolution: float, margin: float = 0.0, most_cells: int = MOST_CELLS) -> OccupancyGrid:
        """Return a grid whose occupied cells are those that a segment runs through, all others free.

        ``resolution``: metres a cell; ``margin``: metres of free space about the outermost ends, at least. A segment
        along the border of two cells makes a wall of one of them. Raises ValueError where the resolution is not
        above 0 and finite, the margin is negative or not finite, or the grid, or the walls, would have more than
        ``most_cells``: a grid takes a byte a cell.
        """
        if not (np.isfinite(resolution) and resolution > 0.0):
            raise ValueError(f"resolution = {resolution!r}; expected metres a cell, finite and above 0")
        if not (np.isfinite(margin) and margin >= 0.0):
            raise ValueError(f"margin = {margin!r}; expected metres, finite and not negative")
        ends = self.segments.reshape(-1, 2)
        corner = ends.min(axis=0) - margin
        columns, rows = ((ends.max(axis=0) + margin - corner) / resolution + 1.0).tolist()
        check_size(columns, rows, most_cells)
        if (on_walls := float(np.sum(self.lengths)) / resolution) > most_cells:
            raise ValueError(f"walls over {on_walls:.0f} cells; expected at most {most_cells}")
        width, height = whole((ends.max(axis=0) + margin - corner) / resolution, 0, 2**31) + 1
        occupied = np.zeros((height, width), dtype=bool)
        for start, end in (self.segments.reshape(-1, 2, 2) - corner) / resolution:
            column, row = _cells_on(start, end)
            occupied[row, column] = True
        return OccupancyGrid.from_bools(occupied, resolution, (float(corner[0]), float(corner[1]), 0.0))

    def _refuse_where(self, wrong: Any, expected: str) -> None:
        for index in np.flatnonzero(wrong)[:1]:
            raise ValueError(f"segment {index} is {self.segments[index].tolist()}; expected {expected}")


def polar_form(segments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rho >= 0 (m) and alpha in (-pi, pi] (rad), each (S,), of the lines that carry segments (S, 4).

    The line is where x cos(alpha) + y sin(alpha) = rho: alpha is the direction of the perpendicular from the origin
    to the line and rho its length. A line through the origin (rho = 0) has two such forms, alpha being pi apart, and
    rounding may give either.
    """
    x1, y1, x2, y2 = segments.T
    length = hypot(x2 - x1, y2 - y1)
    # The normal is a quarter turn from the segment's direction. Of both ends, so that either order gives the same.
    normal_x, normal_y = (y2 - y1) / length, (x1 - x2) / length
    distance = 0.5 * (normal_x * (x1 + x2) + normal_y * (y1 + y2))
    return _positive(distance, atan2(normal_y, normal_x))


def polar_in_frame(rho: FloatArray, alpha: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rho >= 0 (m) and alpha in (-pi, pi] (rad) of a line in the frame of a pose, shape (3, ...).

    rho' = rho - x cos(alpha) - y sin(alpha) and alpha' = alpha - theta (Siegwart, Nourbakhsh, Scaramuzza: Introduction
    to Autonomous Mobile Robots, 2nd ed., section 5.6.8.4); where that makes rho' negative, because the pose lies beyond
    the line, the same line is (-rho', alpha' + pi). Lines and poses broadcast.
    """
    sine, cosine = sincos(alpha)
    distance = rho - pose[0] * cosine - pose[1] * sine
    return _positive(distance, alpha - pose[2])


def _positive(rho: FloatArray, alpha: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the form of a line that has rho >= 0 and alpha in (-pi, pi]."""
    wrapped = wrap_angle(np.where(rho < 0.0, alpha + np.pi, alpha))
    return np.abs(rho), np.where(wrapped == -np.pi, np.pi, wrapped)


def _cells_on(start: FloatArray, end: FloatArray) -> tuple[Any, Any]:
    """Return columns and rows of the cells on the way between two points, both in cells.

    The lines of the grid cut the way into pieces, and each piece lies within one cell: that of its middle.
    """
    cuts = [np.array([0.0, 1.0])]
    for first, last in zip(start, end, strict=True):
        lines = np.arange(math.ceil(min(first, last)), math.floor(max(first, last)) + 1)
        if first != last:
            cuts.append((lines - first) / (last - first))
    along = np.unique(np.concatenate(cuts))
    middles = 0.5 * (along[:-1] + along[1:])
    points = start[:, None] + middles * (end - start)[:, None]
    # Rounding must not lead out of the box of both ends, which is all that the grid need hold.
    low, high = np.minimum(start, end), np.maximum(start, end)
    column, row = whole(np.clip(points, low[:, None], high[:, None]), 0, 2**31)
    return column, row
