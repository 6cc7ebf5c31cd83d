"""Circle fits: an algebraic one to start from, and the geometric one that counts.

Both work on many circles at once: the points of all circles in one array, with a weight for each point of each
circle, so that a point set of any size (weight 0: not mine) takes one call.
"""

import numpy as np

from dynpf import kernels
from dynpf.portable import singular_values
from dynpf.portable.functions import as_values
from dynpf.types import FloatArray

__all__ = ["fit_circle", "fit_circles", "fit_circles_algebraic"]


def fit_circle(points: FloatArray) -> tuple[float, float, float, float]:
    """Return centre x, centre y, radius and rms residual of the geometric fit to `points` (K, 2).

    Any unit of length; the result is in the same. Raises ValueError for fewer than three points, points that
    are not finite, and points on one line.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise ValueError(f"a circle needs at least 3 points of shape (K, 2), got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("points of a circle must be finite")
    spread, _ = singular_values(points - points.mean(axis=0))
    if spread[1] <= 1e-9 * spread[0]:
        raise ValueError(f"the {len(points)} points lie on one line: no circle fits them")
    weights = np.ones((1, len(points)))
    start = fit_circles_algebraic(points[None], weights)
    circle, residual = fit_circles(points[None], weights, start)
    return float(circle[0, 0]), float(circle[0, 1]), float(circle[0, 2]), float(residual[0])


def fit_circles_algebraic(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Return circles (D, 3) as x, y, radius by Taubin's algebraic fit (Taubin 1991, approximate distance).

    `points` is (D, K, 2) or (1, K, 2) when all circles choose from the same points; `weights` is (D, K).
    """
    circles = np.empty((len(weights), 3))
    kernels.circles.fit_algebraic(as_values(points), as_values(weights), circles)
    return circles


def fit_circles(points: FloatArray, weights: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimize sum_j w_j (||p_j - b|| - rho)^2 over b and rho (PARTS section 5.2, stage 6) by Levenberg's method.

    Shapes as in `fit_circles_algebraic`; `start` (D, 3). Returns circles (D, 3) and rms residuals (D,).
    """
    circles, residuals = np.array(start, dtype=np.float64, order="C"), np.empty(len(start))
    kernels.circles.fit_geometric(as_values(points), as_values(weights), circles, residuals)
    return circles, residuals
