"""Gaussian beliefs: the linear Kalman filter, and what the extended and the unscented one share with it."""

from typing import Any, NamedTuple

import numpy as np

from dynpf.covariance import semidefinite_root
from dynpf.measurement.model import MeasurementModel
from dynpf.se2 import FloatArray, wrap_angle

__all__ = [
    "NOTHING_ADMITTED",
    "Gaussian",
    "Innovation",
    "admitted",
    "as_belief",
    "gain",
    "joseph",
    "judged",
    "predict",
    "symmetric_offsets",
    "update",
    "wrap_rows",
]


class Gaussian(NamedTuple):
    """A belief: mean, shape (D,), and covariance, shape (D, D)."""

    mean: FloatArray
    covariance: FloatArray


class Innovation(NamedTuple):
    """What a reading said beyond what was expected of it: measured minus expected (M,), and its covariance (M, M).

    ``nis`` is the normalized innovation squared, the squared Mahalanobis distance: chi-square with M degrees of freedom
    when the filter is consistent; NaN where the innovation is not finite. A reading that was not ``used`` left the
    belief as it was.
    """

    vector: FloatArray
    covariance: FloatArray
    nis: float
    used: bool


NOTHING_ADMITTED = Innovation(np.empty(0), np.empty((0, 0)), np.nan, False)
"""The innovation of a reading in which the measurement model found nothing to believe."""


def predict(belief: Gaussian, transition: FloatArray, process_covariance: FloatArray) -> Gaussian:
    """Return the belief about F x + noise; a random walk has F = I (PARTS eq. 3.28 and 3.29)."""
    covariance = transition @ belief.covariance @ transition.T + process_covariance
    return Gaussian(transition @ belief.mean, _symmetric(covariance))


def update(
    belief: Gaussian, measurement: FloatArray, observation: FloatArray, measurement_covariance: FloatArray
) -> Gaussian:
    """Return the belief given ``measurement`` = H x + noise, (M,), with H (M, D) (PARTS eq. 3.30 and 3.31).

    Raises numpy.linalg.LinAlgError when the innovation covariance is singular.
    """
    weight = gain(belief.covariance, observation, measurement_covariance)
    mean = belief.mean + weight @ (measurement - observation @ belief.mean)
    return Gaussian(mean, joseph(belief.covariance, weight, observation, measurement_covariance))


def gain(covariance: FloatArray, observation: FloatArray, noise: FloatArray) -> FloatArray:
    """Return P H^T (H P H^T + R)^-1, shape (D, M)."""
    expected_spread = observation @ covariance @ observation.T + noise
    return np.asarray(np.linalg.solve(expected_spread, observation @ covariance).T, dtype=np.float64)


def joseph(covariance: FloatArray, weight: FloatArray, observation: FloatArray, noise: FloatArray) -> FloatArray:
    """Return (I - K H) P (I - K H)^T + K R K^T, which stays positive semi-definite whatever rounding does to K."""
    remainder = np.eye(covariance.shape[0]) - weight @ observation
    return _symmetric(remainder @ covariance @ remainder.T + weight @ noise @ weight.T)


def as_belief(mean: FloatArray, covariance: FloatArray, angles: tuple[int, ...]) -> Gaussian:
    """Return the belief with the rows ``angles`` of its mean in [-pi, pi] and its covariance exactly symmetric.

    Raises ValueError when a number in it is not finite.
    """
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise ValueError(f"the belief is not finite: mean {mean.tolist()}, covariance {covariance.tolist()}")
    return Gaussian(wrap_rows(mean, angles), _symmetric(covariance))


def admitted(model: MeasurementModel[Any], belief: Gaussian, reading: Any) -> Any:
    """Return the part of the reading that the model believes; None where that is nothing.

    The model is shown 2 D states of equal weight that have the mean and the covariance of the belief.
    """
    dimension = belief.mean.size
    states = belief.mean[:, None] + symmetric_offsets(belief.covariance, float(dimension))
    return model.admit(states, np.full(2 * dimension, 0.5 / dimension), reading)


def judged(vector: FloatArray, covariance: FloatArray, gate: float | None) -> Innovation:
    """Return the innovation; used if it is finite and, given a gate, its squared Mahalanobis distance within it."""
    if not (np.isfinite(vector).all() and np.isfinite(covariance).all()):
        return Innovation(vector, covariance, np.nan, False)
    nis = float(vector @ np.linalg.solve(covariance, vector))
    return Innovation(vector, covariance, nis, gate is None or nis <= gate)


def symmetric_offsets(covariance: FloatArray, spread: float) -> FloatArray:
    """Return offsets from the mean, shape (D, 2 D): the columns of sqrt(spread P), then their negatives."""
    root = np.sqrt(spread) * semidefinite_root(covariance)
    return np.concatenate((root, -root), axis=1)


def wrap_rows(values: FloatArray, angles: tuple[int, ...]) -> FloatArray:
    """Return the values, shape (D, ...), with the rows ``angles`` in [-pi, pi]."""
    wrapped = values.copy()
    wrapped[list(angles)] = wrap_angle(wrapped[list(angles)])
    return wrapped


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)
