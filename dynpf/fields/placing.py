"""Whether goals are free, and where a part can be put that stands in the way."""

import math

import numpy as np
from numpy.typing import NDArray

from dynpf.fields.layout import Layout
from dynpf.portable import norm
from dynpf.types import FloatArray

__all__ = ["blocked_goals", "free_place"]


GRID = 0.02  # metres between the places that are tried


def blocked_goals(parts: FloatArray, layout: Layout, gap: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (blocked, blocking), both (p,): whose goal is not free, and who stands in another's goal.

    A goal is free when no other part is nearer to the disc to be placed there than ``gap``.
    """
    distance = norm(layout.goals[:, None, :] - parts[None, :, :], axis=2)
    near = distance < layout.radii[:, None] + layout.radii[None, :] + gap
    np.fill_diagonal(near, False)
    return near.any(axis=1), near.any(axis=0)


def free_place(parts: FloatArray, part: int, layout: Layout, gap: float) -> FloatArray | None:
    """Return the place, (2,), for ``part`` by which the way to its goal is shortest; None when there is none.

    It leaves ``gap`` to all other parts, goals and walls, and is sought on a grid of 2 cm.
    """
    others = layout.others(part)
    limit = layout.half_size - layout.radii[part] - gap
    if np.any(limit < 0.0):
        return None
    axes = [GRID * np.arange(math.floor(2.0 * bound / GRID + 0.5) + 1) - bound for bound in limit.tolist()]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    obstacles = np.concatenate([parts[others], layout.goals])
    needed = layout.radii[part] + gap + np.concatenate([layout.radii[others], layout.radii])
    distance = norm(places[:, None, :] - obstacles[None, :, :], axis=2)
    free = places[(distance >= needed).all(axis=1)]
    if not len(free):
        return None
    ways = norm(free - parts[part], axis=1) + norm(free - layout.goals[part], axis=1)
    best: FloatArray = free[np.argmin(ways)]
    return best
