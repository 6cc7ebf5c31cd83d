"""Sub-pixel edges: along rays from a disc's centre, where the contrast is halfway from the inside to the outside.

Inside and outside are taken a little to either side of the rim, ray by ray: a disc may be shaded, and its surroundings
lie in its shadow.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.directions import directions
from dynpf.portable import norm
from dynpf.portable.functions import as_values

__all__ = ["RimEdges", "inner_contrast", "overlapping", "rim_edges"]

_INNER = np.array([0.15, 0.3, 0.45, 0.6])  # of the radius, where the contrast inside is taken
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
    grid = (_INNER[:, None, None] * directions(24)).reshape(-1, 2)
    found = np.empty(len(circles))
    kernels.edges.inner_contrasts(np.require(contrast, np.float32, ["C", "W"]), as_values(circles), grid, found)
    return found


def rim_edges(contrast: NDArray[np.float32], circles: NDArray[np.float64], rays: int) -> RimEdges:
    """Find the edge of each circle (D, 3: x, y, radius) along `rays` directions.

    The edge lies where the contrast falls through the middle between inside and outside: linear between samples half a
    pixel apart, the crossing nearest to the expected rim. A fall of less than a quarter of the disc's contrast is none.
    """
    circles, rays_px = as_values(circles), directions(rays)
    points = np.empty((len(circles), rays, 2))
    visible, found = np.empty((2, len(circles), rays), dtype=np.bool_)
    fall = np.empty((len(circles), rays))
    # Circles that overlap are rivals for one disc: neither hides the other's rim.
    apart = ~overlapping(circles, circles)
    levels = inner_contrast(contrast, circles)
    search = (_REACH_PX, _STEP_PX, _SIDE, _LEAST_FALL, _CLEARANCE_PX)
    kernels.edges.rims(
        np.require(contrast, np.float32, ["C", "W"]),
        circles,
        levels,
        rays_px,
        search,
        apart,
        points,
        visible,
        found,
        fall,
    )
    return RimEdges(points, visible, found, fall)


def overlapping(some: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether circles (D, 3) and (E, 3) overlap by more than measurement makes discs do that touch, (D, E)."""
    between = norm(some[:, None, :2] - others[:, :2], axis=2)
    return np.asarray(between <= _LEAST_SPACING * (some[:, None, 2] + others[:, 2]))
