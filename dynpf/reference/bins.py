"""Poses counted in cells of x, y and heading, with NumPy's sets and a flood fill."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from dynpf.types import Floats

__all__ = ["clusters", "occupied"]

Cells = NDArray[np.int64]


def occupied(  # noqa: PLR0917 - as the kernel takes them
    x: Floats, y: Floats, theta: Floats, weights: Floats, per_x: float, per_y: float, turn_bins: int
) -> int:
    """Return how many cells hold a survivor of a comb of N teeth, half a tooth in, through the weights (N,)."""
    cumulative = np.cumsum(np.fmax(weights, 0.0), dtype=np.float64)
    teeth = np.ceil(cumulative * (weights.size / cumulative[-1]) - 0.5)
    survivors = np.diff(teeth, prepend=0.0) > 0.0
    cells = _cells(np.array([x, y, theta]), (per_x, per_y), turn_bins)
    return len(np.unique(cells[:, survivors & (cells[2] >= 0)], axis=1).T)


def clusters(  # noqa: PLR0917
    x: Floats, y: Floats, theta: Floats, weights: Floats, per_m: float, turn_bins: int, sparse: float
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Return each particle's cluster (N,), -1 for none, the clusters' masses (N,), and the weight in all cells."""
    cells = [tuple(cell) for cell in _cells(np.array([x, y, theta]), (per_m, per_m), turn_bins).T.tolist()]
    mass: dict[tuple[int, ...], float] = {}
    for cell, weight in zip(cells, weights.tolist(), strict=True):
        if weight > 0.0 and cell[2] >= 0:
            mass[cell] = mass.get(cell, 0.0) + weight
    solid = {cell for cell in mass if mass[cell] >= sparse * max(mass.values())}
    masses = np.zeros(x.size)
    cluster: dict[tuple[int, ...], int] = {}
    for number, first in enumerate(mass):
        reached = [first] if first in solid and first not in cluster else []
        cluster |= dict.fromkeys(reached, number)
        for column, row, turn in reached:
            masses[number] += mass[column, row, turn]
            for across, along, about in product((-1, 0, 1), repeat=3):
                beside = (column + across, row + along, (turn + about) % turn_bins)
                if beside in solid and beside not in cluster:
                    cluster[beside] = number
                    reached.append(beside)
    labels = [cluster.get(cell, -1) if weight > 0.0 else -1 for cell, weight in zip(cells, weights, strict=True)]
    return np.array(labels, dtype=np.int32), masses, sum(mass.values())


def _cells(poses: Floats, per_m: tuple[float, float], turn_bins: int) -> Cells:
    """Return column, row and heading cell of each float32 pose, (3, N); the last is -1 where the pose is not finite."""
    finite = np.isfinite(poses).all(axis=0)
    poses = np.where(finite, poses, np.float32(0.0))
    column, row = np.floor(poses[:2] * np.array(per_m, dtype=np.float32)[:, None]).clip(-(2.0**22), 2.0**22)
    turn = poses[2] * np.float32(0.5 / np.pi)
    turn = np.minimum((turn - np.floor(turn)) * np.float32(turn_bins), np.float32(turn_bins - 1))
    return np.where(finite, np.array([column, row, np.floor(turn)]), -1).astype(np.int64)
