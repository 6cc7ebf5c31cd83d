"""Exact ray casting against segments and discs: the distance along a ray to the first surface it meets."""

import numpy as np

from dynpf import kernels
from dynpf.portable.functions import as_values
from dynpf.types import FloatArray

__all__ = ["ray_discs", "ray_segments"]


def ray_segments(origin: FloatArray, angles: FloatArray, segments: FloatArray) -> FloatArray:
    """Return the distance from ``origin`` (2,) along each of ``angles`` (B,) to the nearest of ``segments`` (S, 4).

    A segment is x1, y1, x2, y2; metres and radians. A ray that meets nothing gives infinity. A segment seen end-on
    counts with its nearer end, or with zero where the origin lies on it.
    """
    ranges = np.empty(angles.shape)
    x, y = map(float, origin)
    kernels.surfaces.to_segments(x, y, as_values(angles), as_values(segments).reshape(-1, 4), ranges)
    return ranges


def ray_discs(origin: FloatArray, angles: FloatArray, discs: FloatArray) -> FloatArray:
    """Return the distance from ``origin`` (2,) along each of ``angles`` (B,) to the nearest of ``discs`` (D, 3).

    A disc is x, y, radius; metres and radians. A ray that meets nothing gives infinity, one that starts inside a disc
    gives zero.
    """
    ranges = np.empty(angles.shape)
    x, y = map(float, origin)
    kernels.surfaces.to_discs(x, y, as_values(angles), as_values(discs).reshape(-1, 3), ranges)
    return ranges
