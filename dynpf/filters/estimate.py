"""What weighted particles say about the state: mean and covariance, the modes, and quantiles.

Everywhere a particle whose pose or weight is not finite counts as if it were not there. Weights need not sum to one.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.se2 import circular_mean, wrap_angle
from dynpf.types import FloatArray, Floats

__all__ = [
    "Mode",
    "PoseEstimate",
    "mean_and_covariance",
    "modes",
    "pose_estimate",
    "quantiles",
    "weighted_covariance",
]


class PoseEstimate(NamedTuple):
    """Mean pose (x, y, theta), shape (3,), and its covariance (m^2, m rad, rad^2), shape (3, 3)."""

    mean: FloatArray
    covariance: FloatArray


class Mode(NamedTuple):
    """A cluster of particles: mean pose (3,), covariance (3, 3), and its share of the weight."""

    mean: FloatArray
    covariance: FloatArray
    mass: float


def pose_estimate(particles: Floats, weights: Floats) -> PoseEstimate:
    """Return mean and covariance of particles (D, N), D >= 3, under weights (N,).

    The heading's mean is the circular one, and its deviations are taken the short way round. Where headings cancel
    there is no mean direction: rounding decides it, and only its large variance can tell. Raises ValueError when no
    finite particle has weight.
    """
    if particles.dtype == np.float32:
        mean, covariance = np.empty(3), np.empty((3, 3))
        finite = kernels.estimate.pose_moments(
            particles[0], particles[1], particles[2], np.asarray(weights, dtype=np.float32), mean, covariance
        )
    else:
        mean, covariance = _pose_moments(np.ascontiguousarray(particles[:3], dtype=np.float64), weights)
        finite = np.isfinite(mean).all() and np.isfinite(covariance).all()
    return PoseEstimate(mean, covariance) if finite else pose_estimate(*_finite(particles, weights))


def mean_and_covariance(states: Floats, weights: Floats) -> tuple[FloatArray, FloatArray]:
    """Return mean (D,) and covariance (D, D) of states (D, N), none of them an angle, under weights (N,).

    Raises ValueError when no finite state has weight.
    """
    total = np.sum(weights, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean: FloatArray = np.asarray(np.sum(weights * states, axis=1, dtype=np.float64) / total)
        covariance = weighted_covariance(states - mean[:, None], weights) / total
    if np.isfinite(mean).all() and np.isfinite(covariance).all():
        return mean, covariance
    return mean_and_covariance(*_finite(states, weights, rows=states.shape[0]))


def weighted_covariance(deviation: Floats, weights: Floats) -> FloatArray:
    """Return sum w d d^T of deviations (D, N) from their mean, shape (D, D).

    Summed in float64 in an order that the number of particles alone decides.
    """
    covariance = np.empty((len(deviation), len(deviation)))
    kernels.estimate.scatter(np.ascontiguousarray(deviation), np.ascontiguousarray(weights), covariance)
    return covariance


def _pose_moments(poses: FloatArray, weights: Floats) -> tuple[FloatArray, FloatArray]:
    """Return mean (3,) and covariance (3, 3) of poses (3, N) in float64; not finite where the weights' sum is zero."""
    total = np.sum(weights, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.sum(weights * poses, axis=1) / total
        mean[2] = circular_mean(poses[2], weights)
        deviation = poses - mean[:, None]
        deviation[2] = wrap_angle(deviation[2])
        return mean, weighted_covariance(deviation, weights) / total


def modes(
    particles: Floats,
    weights: Floats,
    *,
    cell_m: float = 0.5,
    cell_rad: float = math.radians(30.0),
    sparse: float = 0.01,
    min_mass: float = 0.02,
) -> tuple[Mode, ...]:
    """Return the clusters of particles (D, N) under weights (N,), the heaviest first.

    Poses are counted in cells of ``cell_m`` by ``cell_m`` by ``cell_rad`` (rounded, so that a whole number of cells
    makes the circle); cells that touch, be it at a corner, belong to one cluster (as in AMCL). Cells lighter than
    ``sparse`` times the heaviest connect nothing and belong to none, so that stray particles do not join two clusters.
    Clusters of less than ``min_mass`` of the weight are left out. Raises ValueError when no finite particle has weight,
    or a cell has no size.
    """
    if not (cell_m > 0.0 and cell_rad >= 1e-3):
        raise ValueError(f"cells of {cell_m} m and {cell_rad} rad: expected more than 0 m and at least 0.001 rad")
    x, y, theta = np.ascontiguousarray(particles[:3], dtype=np.float32)
    weights = np.asarray(weights, dtype=np.float32)
    clusters = np.empty(x.size, dtype=np.int32)
    masses = np.zeros(x.size)
    total = kernels.bins.clusters(x, y, theta, weights, 1.0 / cell_m, turn_bins(cell_rad), sparse, clusters, masses)
    if total == 0.0:
        raise ValueError(_no_weight(particles, weights))
    heavy = np.flatnonzero((masses > 0.0) & (masses >= min_mass * total))
    found = []
    for cluster in heavy[np.argsort(-masses[heavy], kind="stable")]:
        members = np.flatnonzero(clusters == cluster)
        mean, covariance = pose_estimate(particles[:3].take(members, axis=1), weights[members])
        found.append(Mode(mean, covariance, float(masses[cluster] / total)))
    return tuple(found)


def quantiles(values: ArrayLike, weights: ArrayLike, q: float | Sequence[float]) -> NDArray[np.float64]:
    """Return the smallest of the values (N,) at which the cumulative weight reaches a share q, of the shape of q.

    Raises ValueError when no finite value has weight, or q is outside [0, 1].
    """
    shares = np.asarray(q, dtype=np.float64)
    if not ((shares >= 0.0) & (shares <= 1.0)).all():
        raise ValueError(f"q = {q}: expected shares of the weight, from 0 to 1")
    kept, weight = _finite(np.atleast_2d(np.asarray(values)), np.asarray(weights), rows=1, positive=True)
    order = np.argsort(kept[0], kind="stable")
    cumulative = np.cumsum(weight[order], dtype=np.float64)
    # Rounding may leave the last share above the last sum.
    reached = np.searchsorted(cumulative, shares * cumulative[-1]).clip(max=order.size - 1)
    found: NDArray[np.float64] = np.asarray(kept[0][order][reached], dtype=np.float64)
    return found


def turn_bins(cell_rad: float) -> int:
    """Return how many cells of about ``cell_rad`` make the circle."""
    return max(round(2.0 * math.pi / cell_rad), 1)


def _finite(states: Floats, weights: Floats, rows: int = 3, positive: bool = False) -> tuple[Floats, Floats]:
    """Return the columns of which weight and the first ``rows`` are finite; raises ValueError if none has weight.

    Also if none is to be left out: then it is the numbers' size that makes sums of them overflow.
    """
    kept = np.isfinite(weights) & np.isfinite(states[:rows]).all(axis=0)
    if positive:
        kept &= weights > 0.0
    if not np.any(weights[kept] > 0.0) or (kept.all() and not positive):
        raise ValueError(_no_weight(states, weights))
    return np.ascontiguousarray(states[:, kept]), weights[kept]


def _no_weight(states: Floats, weights: Floats) -> str:
    return (
        f"states of shape {states.shape} whose weights sum to {float(np.sum(weights))}: expected one at least that is "
        "finite and has weight"
    )
