"""Circle fits: an algebraic one to start from, and the geometric one that counts.

Both work on many circles at once: the points of all circles in one array, with a weight for each point of each
circle, so that a point set of any size (weight 0: not mine) takes one call.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["fit_circle", "fit_circles", "fit_circles_algebraic"]

_MAX_STEPS = 30
_CONVERGED = 1e-8  # last step relative to the radius; the error is of the order of its square


def fit_circle(points: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return centre x, centre y, radius and rms residual of the geometric fit to `points` (K, 2).

    Any unit of length; the result is in the same. Raises ValueError for fewer than three points, points that
    are not finite, and points on one line.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        raise ValueError(f"a circle needs at least 3 points of shape (K, 2), got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("points of a circle must be finite")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-9 * spread[0]:
        raise ValueError(f"the {len(points)} points lie on one line: no circle fits them")
    weights = np.ones((1, len(points)))
    start = fit_circles_algebraic(points[None], weights)
    circle, residual = fit_circles(points[None], weights, start)
    return float(circle[0, 0]), float(circle[0, 1]), float(circle[0, 2]), float(residual[0])


def fit_circles_algebraic(points: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return circles (D, 3) as x, y, radius by Taubin's algebraic fit (Taubin 1991, approximate distance).

    `points` is (D, K, 2) or (1, K, 2) when all circles choose from the same points; `weights` is (D, K). The
    smallest eigenvector of the 3 x 3 moment matrix of (z, x, y), z = x^2 + y^2 centred and scaled, is the circle.
    """
    total = np.maximum(weights.sum(axis=1), 1e-12)
    share = weights / total[:, None]
    every = np.broadcast_to(points, (len(weights), *points.shape[1:]))
    mean = np.einsum("dk,dkc->dc", share, every)
    centred = every - mean[:, None]
    z = (centred**2).sum(axis=2)
    mean_z = np.maximum((share * z).sum(axis=1), 1e-24)
    scale = 2 * np.sqrt(mean_z)
    columns = np.concatenate([((z - mean_z[:, None]) / scale[:, None])[..., None], centred], axis=2)
    moments = np.einsum("dki,dkj->dij", share[..., None] * columns, columns)
    smallest = np.linalg.eigh(moments)[1][:, :, 0]
    curvature = np.where(np.abs(smallest[:, 0]) < 1e-9, 1e-9, smallest[:, 0])  # nearly 0: a straight line
    offset = -smallest[:, 1:] * (scale / (2 * curvature))[:, None]
    radius = np.sqrt((offset**2).sum(axis=1) + mean_z)
    return np.concatenate([mean + offset, radius[:, None]], axis=1)


def fit_circles(
    points: NDArray[np.float64], weights: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minimize sum_j w_j (||p_j - b|| - rho)^2 over b and rho (PARTS section 5.2, stage 6) by Levenberg's method.

    Shapes as in `fit_circles_algebraic`; `start` (D, 3). Returns circles (D, 3) and rms residuals (D,).
    """
    circles = start.copy()
    total = np.maximum(weights.sum(axis=1), 1e-12)
    damping = np.full(len(circles), 1e-6)
    direction, error = _residuals(points, circles)
    cost = (weights * error**2).sum(axis=1)
    for _ in range(_MAX_STEPS):
        jacobian = np.concatenate([direction, np.ones_like(error)[..., None]], axis=2)
        weighted = jacobian * weights[..., None]
        normal = np.einsum("dki,dkj->dij", weighted, jacobian)
        gradient = np.einsum("dki,dk->di", weighted, error)[..., None]
        ridge = (damping * total + 1e-12)[:, None, None] * np.eye(3)
        step = np.linalg.solve(normal + ridge, gradient)[..., 0]
        trial = circles + step
        trial_direction, trial_error = _residuals(points, trial)
        trial_cost = (weights * trial_error**2).sum(axis=1)
        better = trial_cost <= cost
        circles = np.where(better[:, None], trial, circles)
        direction = np.where(better[:, None, None], trial_direction, direction)
        error = np.where(better[:, None], trial_error, error)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping * 0.1, damping * 10)
        if np.all(np.abs(step).max(axis=1) <= _CONVERGED * (1 + np.abs(circles[:, 2]))):
            break
    return circles, np.sqrt(cost / total)


def _residuals(
    points: NDArray[np.float64], circles: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors from the centre to each point (D, K, 2) and signed distances to the rim (D, K)."""
    offset = points - circles[:, None, :2]
    distance = np.maximum(np.sqrt((offset**2).sum(axis=2)), 1e-12)
    return offset / distance[..., None], distance - circles[:, None, 2]
