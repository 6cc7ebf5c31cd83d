"""Exact rays from one point to segments and discs: the distance to the nearest along each. Everything is float64."""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary64 import sincos

__all__ = ["to_discs", "to_segments"]

# A ray through the corner where two segments meet must not slip between them by rounding.
_CORNER = 1e-12


@device
def _to_segment(along_x, along_y, start_x, start_y, side_x, side_y):
    """Return the distance along a unit vector to a segment from ``start``, seen from there, to ``start + side``."""
    denominator = along_x * side_y - along_y * side_x
    offset = start_x * along_y - start_y * along_x
    if denominator == 0.0:
        first = start_x * along_x + start_y * along_y
        second = (start_x + side_x) * along_x + (start_y + side_y) * along_y
        end_on = offset == 0.0 and max(first, second) >= 0.0
        return max(min(first, second), 0.0) if end_on else np.inf
    distance = (start_x * side_y - start_y * side_x) / denominator
    fraction = offset / denominator
    met = distance >= 0.0 and fraction >= -_CORNER and fraction <= 1.0 + _CORNER
    return distance if met else np.inf


@kernel
def to_segments(x, y, angles, segments, out):
    """Fill ``out`` (B,) with the distance along ``angles`` (B,) to the nearest of ``segments`` (S, 4), or infinity."""
    for b in range(angles.size):
        along_y, along_x = sincos(angles[b])
        nearest = np.inf
        for s in range(len(segments)):
            start_x, start_y = segments[s, 0] - x, segments[s, 1] - y
            side_x, side_y = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
            nearest = min(nearest, _to_segment(along_x, along_y, start_x, start_y, side_x, side_y))
        out[b] = nearest


@device
def _to_disc(along_x, along_y, centre_x, centre_y, radius):
    """Return the distance along a unit vector to a disc, its centre seen from the origin; zero from inside."""
    if centre_x * centre_x + centre_y * centre_y <= radius * radius:
        return 0.0
    along = centre_x * along_x + centre_y * along_y
    across = along_x * centre_y - along_y * centre_x
    half_chord_squared = radius * radius - across * across
    met = half_chord_squared >= 0.0 and along >= 0.0
    return along - np.sqrt(half_chord_squared) if met else np.inf


@kernel
def to_discs(x, y, angles, discs, out):
    """Fill ``out`` (B,) with the distance along ``angles`` (B,) to the nearest of ``discs`` (D, 3), or infinity."""
    for b in range(angles.size):
        along_y, along_x = sincos(angles[b])
        nearest = np.inf
        for d in range(len(discs)):
            nearest = min(nearest, _to_disc(along_x, along_y, discs[d, 0] - x, discs[d, 1] - y, discs[d, 2]))
        out[b] = nearest
