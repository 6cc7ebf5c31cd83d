"""Exact Euclidean distances to walls, from the definition."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["squared_distances"]


def squared_distances(occupied: NDArray[np.bool_], far: int) -> NDArray[np.int32]:
    """Return the squared distances in cells, shape (H, W), to the nearest true cell; ``far`` if there is none."""
    walls = np.argwhere(occupied)
    squared = np.full(occupied.shape, far, dtype=np.int32)
    for cell in np.ndindex(occupied.shape):
        squared[cell] = ((walls - cell) ** 2).sum(axis=1).min(initial=far)
    return squared
