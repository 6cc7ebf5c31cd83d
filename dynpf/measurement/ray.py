"""Exact ray casting against segments and discs: the distance along a ray to the first surface it meets."""

import numpy as np
from numpy.typing import NDArray

from dynpf.portable import sincos

__all__ = ["ray_discs", "ray_segments"]

Floats = NDArray[np.float64]

# A ray through the corner where two segments meet must not slip between them by rounding.
_CORNER = 1e-12


def ray_segments(origin: Floats, angles: Floats, segments: Floats) -> Floats:
    """Return the distance from ``origin`` (2,) along each of ``angles`` (B,) to the nearest of ``segments`` (S, 4).

    A segment is x1, y1, x2, y2; metres and radians. A ray that meets nothing gives infinity. A segment seen end-on
    counts with its nearer end, or with zero where the origin lies on it.
    """
    direction = _directions(angles)  # (B, 1, 2)
    start = segments[None, :, :2] - origin  # (1, S, 2)
    along = segments[None, :, 2:] - segments[None, :, :2]
    denominator = _cross(direction, along)  # (B, S)
    offset = _cross(start, direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _cross(start, along) / denominator
        fraction = offset / denominator
    hit = (distance >= 0.0) & (fraction >= -_CORNER) & (fraction <= 1.0 + _CORNER)
    ranges = np.where(hit, distance, np.inf)

    end_on = (denominator == 0.0) & (offset == 0.0)
    if end_on.any():
        first = np.sum(start * direction, axis=2)
        second = np.sum((start + along) * direction, axis=2)
        ahead = np.maximum(first, second) >= 0.0
        nearer = np.where(ahead, np.maximum(np.minimum(first, second), 0.0), np.inf)
        ranges = np.where(end_on, nearer, ranges)
    return _nearest(ranges)


def ray_discs(origin: Floats, angles: Floats, discs: Floats) -> Floats:
    """Return the distance from ``origin`` (2,) along each of ``angles`` (B,) to the nearest of ``discs`` (D, 3).

    A disc is x, y, radius; metres and radians. A ray that meets nothing gives infinity, one that starts inside a disc
    gives zero.
    """
    direction = _directions(angles)
    centre = discs[None, :, :2] - origin
    radius = discs[None, :, 2]
    along = np.sum(centre * direction, axis=2)
    half_chord_squared = radius**2 - _cross(direction, centre) ** 2
    entry = along - np.sqrt(np.maximum(half_chord_squared, 0.0))
    ranges = np.where((half_chord_squared >= 0.0) & (along >= 0.0), entry, np.inf)
    inside = np.sum(centre**2, axis=2) <= radius**2
    return _nearest(np.where(inside, 0.0, ranges))


def _directions(angles: Floats) -> Floats:
    """Return unit vectors (B, 1, 2)."""
    sine, cosine = sincos(angles)
    return np.stack([cosine, sine], axis=1)[:, None, :]


def _cross(a: Floats, b: Floats) -> Floats:
    cross: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return cross


def _nearest(ranges: Floats) -> Floats:
    nearest: Floats = np.min(ranges, axis=1, initial=np.inf)
    return nearest
