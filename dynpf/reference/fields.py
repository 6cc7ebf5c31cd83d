"""Potentials on a grid, from the upwind equations that fast marching solves."""

import numpy as np
from numpy.typing import NDArray

from dynpf.types import FloatArray

__all__ = ["interpolate", "march", "spare_clearances"]


def spare_clearances(
    points: FloatArray, radius: float, centres: FloatArray, kept: FloatArray, half_size: FloatArray
) -> FloatArray:
    """Return what is left, (N,), for a disc at ``points`` (N, 2) before obstacles (n, 2) and walls begin."""
    discs = np.linalg.norm(points[:, None, :] - centres[None, :, :], axis=2) - (radius + kept)
    walls = (half_size - np.abs(points)).min(axis=1) - radius
    left: FloatArray = np.minimum(discs.min(axis=1, initial=np.inf), walls)
    return left


def march(
    values: FloatArray, slowness: FloatArray, spacing: FloatArray, layers: int, beyond: float
) -> tuple[FloatArray, NDArray[np.int8]]:
    """Return V (X, Y, T) with |grad V| = slowness from the finite ``values``, the last axis periodic, and the depths.

    The upwind equations are iterated, at all nodes together, until nothing changes.
    """
    seeds, closed = np.isfinite(values), np.isinf(slowness)
    solved = values.astype(np.float64)
    while True:
        lower = np.stack([_lower(solved, axis) for axis in range(3)])
        updated = np.where(closed | seeds, solved, np.minimum(solved, _upwind(lower, slowness, spacing)))
        if np.array_equal(updated, solved):
            break
        solved = updated
    depths = np.where(np.isfinite(solved), 0, -1).astype(np.int8)
    for layer in range(1, layers + 1):
        inner = np.where(depths == layer - 1, solved, np.inf)
        reached = np.min([_lower(inner, axis) + beyond * spacing[axis] for axis in range(3)], axis=0)
        new = closed & (depths < 0) & np.isfinite(reached)
        solved, depths = np.where(new, reached, solved), np.where(new, np.int8(layer), depths)
    return solved, depths


def interpolate(ratios: FloatArray, frame: FloatArray, states: FloatArray) -> FloatArray:
    """Return sqrt(||b - g||^2 + tip^2) times the ratio at states (N, 3), linear along each axis between finite nodes.

    ``frame``: x and y of node (0, 0), nodes a metre, nodes a radian, the goal's x and y, and the tip.
    """
    return np.array([_interpolate_one(ratios, frame, state) for state in states])


def _interpolate_one(ratios: FloatArray, frame: FloatArray, state: FloatArray) -> float:
    last = np.array(ratios.shape[:2]) - 1
    position = np.clip((state[:2] - frame[:2]) * frame[2], 0.0, last)
    turns = state[2] * frame[3]
    first = np.append(np.minimum(position.astype(int), last - 1), int(np.floor(turns)))
    fraction = np.append(position, turns) - first
    total = weights = 0.0
    for corner in np.ndindex(2, 2, 2):
        i, j, k = first + corner
        weight = float(np.prod(np.where(corner, fraction, 1.0 - fraction)))
        ratio = ratios[i, j, k % ratios.shape[2]]
        if weight > 0.0 and np.isfinite(ratio):
            total, weights = total + weight * ratio, weights + weight
    distance = float(np.linalg.norm([*(state[:2] - frame[4:6]), frame[6]]))
    return distance * total / weights if weights > 0.0 else np.inf


def _lower(values: FloatArray, axis: int) -> FloatArray:
    """Return the lower of the two neighbours along an axis; infinite beyond the border and along an axis of one."""
    if values.shape[axis] == 1:
        return np.full_like(values, np.inf)
    before, after = np.roll(values, 1, axis), np.roll(values, -1, axis)
    if axis < 2:
        before[(slice(None),) * axis + (0,)] = np.inf
        after[(slice(None),) * axis + (-1,)] = np.inf
    lower: FloatArray = np.minimum(before, after)
    return lower


def _upwind(lower: FloatArray, slowness: FloatArray, spacing: FloatArray) -> FloatArray:
    """Return the lowest V that solves sum ((V - a) / h)^2 = slowness^2 over the one, two or three lowest neighbours."""
    order = np.argsort(lower, axis=0)
    a = np.take_along_axis(lower, order, axis=0)
    weights = 1.0 / spacing[order] ** 2
    solution = a[0] + slowness * spacing[order[0]]
    for count in (2, 3):
        with np.errstate(invalid="ignore"):
            total = weights[:count].sum(axis=0)
            mixed = (weights[:count] * (a[:count] - a[0])).sum(axis=0)
            rest = (weights[:count] * (a[:count] - a[0]) ** 2).sum(axis=0) - slowness**2
            root = a[0] + (mixed + np.sqrt(mixed**2 - total * rest)) / total
            solution = np.where(solution > a[count - 1], root, solution)
    return np.asarray(solution)
