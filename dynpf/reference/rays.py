"""Exact rays through a grid, cell by cell, for ``dynpf.kernels.rays``."""

import numpy as np
from numpy.typing import NDArray

from dynpf.types import FloatArray

__all__ = ["cast"]


def cast(
    occupied: NDArray[np.bool_], column: FloatArray, row: FloatArray, direction: FloatArray, reach: float
) -> FloatArray:
    """Return the lengths (N,), in cells, of rays until they enter an occupied cell of a grid (H, W), at most ``reach``.

    Origins (N,) in cells and directions in radians in the grid's frame; outside the grid all is free. Amanatides and
    Woo (1987): of the next border of a column and the next border of a row, cross the nearer.
    """
    height, width = occupied.shape
    length = np.full(column.size, float(reach))
    ray = np.arange(column.size)
    cell = np.stack((np.floor(column), np.floor(row))).astype(int)
    along = np.stack((np.cos(direction), np.sin(direction)))
    step = np.where(along > 0.0, 1, -1)
    with np.errstate(divide="ignore"):
        per_cell = np.abs(1.0 / along)
    next_border = np.abs(cell + (step > 0) - np.stack((column, row))) * per_cell
    travelled = np.zeros(column.size)
    while ray.size:
        inside = (cell >= 0).all(axis=0) & (cell[0] < width) & (cell[1] < height)
        stopped = np.zeros(ray.size, dtype=bool)
        stopped[inside] = occupied[cell[1, inside], cell[0, inside]]
        length[ray[stopped]] = travelled[stopped]
        axis, all_rays = np.argmin(next_border, axis=0), np.arange(ray.size)
        travelled = next_border[axis, all_rays]
        cell[axis, all_rays] += step[axis, all_rays]
        next_border[axis, all_rays] += per_cell[axis, all_rays]
        on = ~stopped & (travelled < reach)
        ray, cell, step, per_cell, next_border = ray[on], cell[:, on], step[:, on], per_cell[:, on], next_border[:, on]
        travelled = travelled[on]
    return length
