"""Sub-pixel edges: along rays from a disc's centre, where the contrast is halfway from the inside to the outside.

Inside and outside are taken a little to either side of the rim, ray by ray: a disc may be shaded, and its surroundings
lie in its shadow.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["RimEdges", "inner_contrast", "overlapping", "rim_edges"]

_REACH_PX = 3.0  # how far from the expected rim an edge is looked for
_STEP_PX = 0.5
_SIDE = 3  # samples to either side that tell inside and outside
_LEAST_FALL = 0.25
_LEAST_SPACING = 0.75  # of two discs' centres, relative to the sum of their radii
_CLEARANCE_PX = 2.5  # a rim this close to another disc is blurred into it and is not used


class RimEdges(NamedTuple):
    """Edge points on the rays of D discs, R rays each."""

    points_px: NDArray[np.float64]  # (D, R, 2)
    visible: NDArray[np.bool_]  # (D, R) the ray ends in the image, and not beside another disc
    found: NDArray[np.bool_]  # (D, R) it is visible and has an edge
    fall: NDArray[np.float64]  # (D, R) of the contrast there, grey levels; 0: no edge


def inner_contrast(contrast: NDArray[np.float32], circles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median contrast (D,) well inside each circle (D, 3)."""
    angle = np.arange(24) * (2 * np.pi / 24)
    fraction = np.array([0.15, 0.3, 0.45, 0.6])
    grid = fraction[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = circles[:, None, :2] + circles[:, 2, None, None] * grid.reshape(1, -1, 2)
    return np.asarray(np.median(_bilinear(contrast, points), axis=1))


def rim_edges(contrast: NDArray[np.float32], circles: NDArray[np.float64], rays: int) -> RimEdges:
    """Find the edge of each circle (D, 3: x, y, radius) along `rays` directions.

    The edge lies where the contrast falls through the middle between inside and outside: linear between samples half a
    pixel apart, the crossing nearest to the expected rim. A fall of less than a quarter of the disc's contrast is none.
    """
    height, width = contrast.shape
    angle = np.arange(rays) * (2 * np.pi / rays)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX / 2, _STEP_PX)
    along = circles[:, 2, None] + offset
    points = circles[:, None, None, :2] + along[:, None, :, None] * direction[None, :, None, :]
    level = inner_contrast(contrast, circles)
    level = np.where(np.abs(level) < 1e-3, 1e-3, level)
    relative = _bilinear(contrast, points) / level[:, None, None]
    inside = relative[..., :_SIDE].mean(axis=2, keepdims=True)
    outside = relative[..., -_SIDE:].min(axis=2, keepdims=True)
    fall = np.maximum(inside - outside, _LEAST_FALL)
    profile = (relative - 0.5 * (inside + outside)) / fall

    falls = (profile[..., :-1] >= 0) & (profile[..., 1:] < 0) & (inside - outside >= _LEAST_FALL)
    drop = np.where(falls, profile[..., :-1] - profile[..., 1:], 1.0)
    crossing = offset[:-1] + _STEP_PX * profile[..., :-1] / drop
    closeness = np.where(falls, np.abs(crossing), np.inf)
    nearest = np.argmin(closeness, axis=2)[..., None]
    found = np.isfinite(np.take_along_axis(closeness, nearest, axis=2)[..., 0])
    shift = np.where(found, np.take_along_axis(crossing, nearest, axis=2)[..., 0], 0.0)

    shift += _blur_inset(drop, nearest, found, circles[:, 2])[:, None]
    rim = circles[:, None, :2] + (circles[:, 2, None] + shift)[..., None] * direction
    last = np.array([width - 1, height - 1])
    seen = ((points[:, :, -1] >= 0) & (points[:, :, -1] <= last)).all(axis=2)
    visible = seen & ~_beside_another(rim, circles)
    found &= visible
    return RimEdges(rim, visible, found, np.where(found, fall[..., 0] * np.abs(level)[:, None], 0.0))


def _blur_inset(
    drop: NDArray[np.float64], nearest: NDArray[np.intp], found: NDArray[np.bool_], radius: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far blur pulls the half-height edge of each disc inward, (D,): sigma^2 / (2 radius) for a Gaussian.

    sigma follows from the slope at half height, 1 / (sigma sqrt(2 pi)), of which the mean over the rays is taken.
    """
    fall = np.where(found, np.take_along_axis(drop, nearest, axis=2)[..., 0], 0.0)
    slope = fall.sum(axis=1) / np.maximum(found.sum(axis=1), 1) / _STEP_PX
    sigma = 1 / (np.sqrt(2 * np.pi) * np.maximum(slope, 0.2))
    return np.asarray(sigma**2 / (2 * radius))


def _beside_another(rim: NDArray[np.float64], circles: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (D, R) of the rims are close to or in another disc; circles that overlap are rivals for one disc."""
    gap = np.hypot(*(rim[:, :, None] - circles[:, :2]).transpose(3, 0, 1, 2)) - circles[:, 2]
    beside = ~overlapping(circles, circles)[:, None, :]
    return np.asarray(((gap < _CLEARANCE_PX) & beside).any(axis=2))


def overlapping(some: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether circles (D, 3) and (E, 3) overlap by more than measurement makes discs do that touch, (D, E)."""
    between = np.hypot(*(some[:, None, :2] - others[:, :2]).transpose(2, 0, 1))
    return np.asarray(between <= _LEAST_SPACING * (some[:, None, 2] + others[:, 2]))


def _bilinear(image: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sample `image` at points (..., 2) x, y; outside, the border's value."""
    height, width = image.shape
    x = np.clip(points[..., 0], 0, width - 1)
    y = np.clip(points[..., 1], 0, height - 1)
    left = np.minimum(x.astype(np.intp), max(width - 2, 0))
    top = np.minimum(y.astype(np.intp), max(height - 2, 0))
    right, bottom = min(1, width - 1), min(1, height - 1) * width
    fx, fy = x - left, y - top
    flat = image.ravel()
    at = top * width + left
    upper = flat[at] * (1 - fx) + flat[at + right] * fx
    lower = flat[at + bottom] * (1 - fx) + flat[at + bottom + right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)
