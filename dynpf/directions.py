"""Directions all round, which rays, rims and grippers are taken at."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dynpf.portable import sincos

__all__ = ["directions"]


@lru_cache(maxsize=16)
def directions(count: int) -> NDArray[np.float64]:
    """Return so many unit vectors (count, 2), evenly about the circle from (1, 0) on; not to be changed."""
    sines, cosines = sincos(np.arange(count) * (2 * np.pi / count))
    return np.stack([cosines, sines], axis=1)
