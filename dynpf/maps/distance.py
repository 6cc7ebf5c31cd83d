"""The Euclidean distance field: how far each cell is from the nearest wall."""

import math

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels

__all__ = ["FAR", "distance_field", "squared_distances"]

FAR = 2**31 - 1
"""The squared distance where there is no wall at all."""


def squared_distances(occupied: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the squared distance from each cell's centre to the nearest true cell's, in cells, exact, shape (H, W).

    FAR everywhere in an array without a true cell. Raises ValueError for an array whose diagonal, squared, is no
    smaller than FAR.
    """
    height, width = occupied.shape
    if height * height + width * width >= FAR:
        raise ValueError(f"{width} x {height} cells; expected sides whose squares add up to less than {FAR}")
    squared: NDArray[np.int32] = kernels.distance.squared_distances(np.array(occupied, dtype=bool, order="C"), FAR)
    return squared


def distance_field(
    occupied: NDArray[np.bool_], resolution: float, max_distance: float = math.inf
) -> NDArray[np.float32]:
    """Return the distance in metres from each cell's centre to the nearest true cell's, at most ``max_distance``.

    ``occupied``: walls, shape (H, W), as ``OccupancyGrid.occupied``; ``resolution``: metres a cell. Without a wall the
    distance is ``max_distance``, infinite by default, everywhere. Raises ValueError where ``max_distance`` is not
    above 0, and as ``squared_distances`` does.
    """
    if not max_distance > 0.0:
        raise ValueError(f"max_distance = {max_distance!r}; expected metres, above 0")
    squared = squared_distances(occupied)
    metres = np.sqrt(squared, dtype=np.float64) * resolution
    metres[squared == FAR] = math.inf
    return np.minimum(metres, max_distance).astype(np.float32)
