"""Numbers as a page holds them: rounded, bounded, and fewer where there are many."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf.types import FloatArray

__all__ = ["column", "evenly", "extremes", "points", "runs"]

LARGEST = 1e9
"""Greater numbers are not drawn, nor told: they are no positions, errors or times of a robot."""

_STEPS = 32_000  # of a packed coordinate


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` of ``count`` things, at even distances, with the first and the last."""
    if count <= most:
        return np.arange(count)
    return (np.arange(most) * (count - 1)) // (most - 1)


def extremes(values: FloatArray, most: int) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` values, the least and the greatest of each of as many equal pieces.

    So no peak is lost. NaN counts as least.
    """
    if values.size <= most:
        return np.arange(values.size)
    edges = (np.arange(most // 2 + 1) * values.size) // (most // 2)
    known = np.where(np.isnan(values), -np.inf, values)
    chosen = [
        begin + function(known[begin:end])
        for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        for function in (np.argmin, np.argmax)
    ]
    return np.unique(chosen).astype(np.intp)


def column(values: ArrayLike, quantum: float) -> dict[str, Any]:
    """Return numbers (T,) as multiples of ``quantum``: the first, then differences; None where there is no number."""
    numbers = np.asarray(values, dtype=np.float64)
    known = np.isfinite(numbers) & (np.abs(numbers) <= LARGEST)
    steps = np.rint(np.where(known, numbers, 0.0) / quantum).astype(np.int64)
    found: list[int | None] = [None] * numbers.size
    before = 0
    for index in np.flatnonzero(known).tolist():
        step = int(steps[index])
        found[index], before = step - before, step
    return {"q": quantum, "d": found}


def points(clouds: Sequence[FloatArray], least: float = 1e-3) -> dict[str, Any]:
    """Return sets of points (2, M) packed into one text: 16-bit offsets from each set's middle, in steps of a quantum.

    The quantum is the same for all, and at least ``least``. Points that are no numbers are left out.
    """
    kept = [cloud[:, np.all(np.isfinite(cloud) & (np.abs(cloud) <= LARGEST), axis=0)] for cloud in clouds]
    middles = [0.5 * (cloud.min(axis=1) + cloud.max(axis=1)) if cloud.size else np.zeros(2) for cloud in kept]
    reach = max(
        (float(np.max(np.abs(c - m[:, None]))) for c, m in zip(kept, middles, strict=True) if c.size), default=0
    )
    quantum = max(least, reach / _STEPS)
    packed = [
        np.rint((cloud - middle[:, None]) / quantum).T.astype("<i2")
        for cloud, middle in zip(kept, middles, strict=True)
    ]
    return {
        "q": quantum,
        "x": column([middle[0] for middle in middles], least),
        "y": column([middle[1] for middle in middles], least),
        "n": [len(rows) for rows in packed],
        "b": base64.b64encode(b"".join(rows.tobytes() for rows in packed)).decode("ascii"),
    }


def runs(cells: NDArray[np.uint8]) -> list[int]:
    """Return cells (H, W) of values below 4, row by row, as runs: four times the length plus the value."""
    flat = cells.reshape(-1)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(flat)) + 1])
    lengths = np.diff(np.append(starts, flat.size))
    return [int(run) for run in 4 * lengths + flat[starts]]
