"""Gaussian beliefs: the linear Kalman filter, and what the extended and the unscented one share with it."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.covariance import negative_eigenvalue
from dynpf.filters.shapes import shaped
from dynpf.measurement.model import MeasurementModel
from dynpf.portable import SingularMatrixError, product
from dynpf.se2 import wrap_angle
from dynpf.types import FloatArray

__all__ = [
    "NOTHING_ADMITTED",
    "Gaussian",
    "Innovation",
    "admitted",
    "as_belief",
    "corrected",
    "expected_spread",
    "gain",
    "joseph",
    "judged",
    "not_finite",
    "predict",
    "predicted",
    "symmetric_offsets",
    "update",
    "weighed",
    "wrap_rows",
]


class Gaussian(NamedTuple):
    """A belief: mean, shape (D,), and covariance, shape (D, D)."""

    mean: FloatArray
    covariance: FloatArray


class Innovation(NamedTuple):
    """The difference between a reading and its expectation: measured minus expected (M,), and its covariance (M, M).

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


_NO_ANGLES = np.empty(0, dtype=np.int64)


def predict(belief: Gaussian, transition: FloatArray, process_covariance: FloatArray) -> Gaussian:
    """Return the belief about F x + noise; a random walk has F = I (PARTS eq. 3.28 and 3.29)."""
    return predicted(belief, product(transition, belief.mean), transition, process_covariance)[0]


def predicted(
    belief: Gaussian,
    mean: FloatArray,
    transition: FloatArray,
    process_covariance: FloatArray,
    angles: NDArray[np.int64] = _NO_ANGLES,
) -> tuple[Gaussian, bool]:
    """Return the belief of a mean that is known, its rows ``angles`` in [-pi, pi], and whether all of it is finite.

    Its covariance is F P F^T + Q.
    """
    size = mean.size
    finite = kernels.gaussian.predict(
        shaped("a mean", mean, size),
        shaped("a transition matrix", transition, size, size),
        shaped("a covariance", belief.covariance, size, size),
        shaped("a process covariance", process_covariance, size, size),
        angles,
        *(after := _empty(size)),
    )
    return after, finite


def update(
    belief: Gaussian, measurement: FloatArray, observation: FloatArray, measurement_covariance: FloatArray
) -> Gaussian:
    """Return the belief given ``measurement`` = H x + noise, (M,), with H (M, D) (PARTS eq. 3.30 and 3.31).

    Raises SingularMatrixError when the innovation covariance is singular.
    """
    vector = measurement - product(observation, belief.mean)
    return corrected(belief, vector, observation, measurement_covariance)


def corrected(
    belief: Gaussian,
    innovation: FloatArray,
    observation: FloatArray,
    noise: FloatArray,
    angles: NDArray[np.int64] = _NO_ANGLES,
) -> Gaussian:
    """Return the belief given the innovation (M,) of a reading with H (M, D) and R (M, M); it may not be finite.

    The rows ``angles`` of its mean are in [-pi, pi]. Raises SingularMatrixError when the innovation covariance is
    singular.
    """
    size, rows = belief.mean.size, len(observation)
    regular = kernels.gaussian.correct(
        shaped("a mean", belief.mean, size),
        shaped("a covariance", belief.covariance, size, size),
        shaped("an innovation", innovation, rows),
        shaped("an observation matrix", observation, rows, size),
        shaped("a measurement covariance", noise, rows, rows),
        angles,
        *(after := _empty(size)),
    )
    if not regular:
        raise _singular(expected_spread(belief.covariance, observation, noise))
    return after


def expected_spread(covariance: FloatArray, observation: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the innovation's covariance H P H^T + R, shape (M, M)."""
    spread = np.empty((len(observation), len(observation)))
    kernels.gaussian.carry(*_matrices(covariance, observation, noise), spread)
    return spread


def gain(covariance: FloatArray, observation: FloatArray, noise: FloatArray) -> FloatArray:
    """Return P H^T (H P H^T + R)^-1, shape (D, M); raises SingularMatrixError where there is no such inverse."""
    weight = np.empty((len(covariance), len(observation)))
    if not kernels.gaussian.weigh(*_matrices(covariance, observation, noise), weight):
        raise _singular(expected_spread(covariance, observation, noise))
    return weight


def joseph(covariance: FloatArray, weight: FloatArray, observation: FloatArray, noise: FloatArray) -> FloatArray:
    """Return (I - K H) P (I - K H)^T + K R K^T, which stays positive semi-definite whatever rounding does to K."""
    size, rows = len(covariance), len(observation)
    after = np.empty((size, size))
    kernels.gaussian.joseph(shaped("a gain", weight, size, rows), *_matrices(covariance, observation, noise), after)
    return after


def as_belief(mean: FloatArray, covariance: FloatArray, angles: tuple[int, ...]) -> Gaussian:
    """Return the belief with the rows ``angles`` of its mean in [-pi, pi] and its covariance exactly symmetric.

    Raises ValueError when a number in it is not finite.
    """
    belief = Gaussian(wrap_rows(mean, angles), _symmetric(covariance))
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise not_finite(belief)
    return belief


def not_finite(belief: Gaussian) -> ValueError:
    """Return the error for a belief that is not finite."""
    return ValueError(f"the belief is not finite: mean {belief.mean.tolist()}, covariance {belief.covariance.tolist()}")


def admitted(model: MeasurementModel[Any], belief: Gaussian, reading: Any) -> Any:
    """Return the part of the reading that the model believes; None where that is nothing.

    The model is shown 2 D states of equal weight that have the mean and the covariance of the belief.
    """
    dimension = belief.mean.size
    states = belief.mean[:, None] + symmetric_offsets(belief.covariance, float(dimension))
    return model.admit(states, np.full(2 * dimension, 0.5 / dimension), reading)


def judged(vector: FloatArray, covariance: FloatArray, gate: float | None) -> Innovation:
    """Return the innovation; used if it is finite and, given a gate, its squared Mahalanobis distance within it.

    Raises SingularMatrixError where the covariance has no inverse.
    """
    rows = len(covariance)
    distance = kernels.gaussian.mahalanobis(
        shaped("an innovation covariance", covariance, rows, rows), shaped("an innovation", vector, rows)
    )
    return weighed(vector, covariance, distance, gate)


def weighed(vector: FloatArray, covariance: FloatArray, distance: tuple[float, bool], gate: float | None) -> Innovation:
    """Return the innovation for a kernel's result (see ``kernels.gaussian.mahalanobis``); raises as ``judged`` does."""
    nis, regular = distance
    if not regular:
        raise _singular(covariance)
    return Innovation(vector, covariance, nis, not math.isnan(nis) if gate is None else nis <= gate)


def symmetric_offsets(covariance: FloatArray, spread: float) -> FloatArray:
    """Return offsets from the mean, shape (D, 2 D): the columns of sqrt(spread P), then their negatives.

    Raises ValueError for a covariance with a negative eigenvalue.
    """
    dimension = len(covariance)
    given, offsets = shaped("a covariance", covariance, dimension, dimension), np.empty((dimension, 2 * dimension))
    if not kernels.gaussian.offsets(given, spread, offsets):
        raise negative_eigenvalue(given)
    return offsets


def wrap_rows(values: FloatArray, angles: tuple[int, ...]) -> FloatArray:
    """Return the values, shape (D, ...), with the rows ``angles`` in [-pi, pi]."""
    wrapped = values.copy()
    wrapped[list(angles)] = wrap_angle(wrapped[list(angles)])
    return wrapped


def _empty(size: int) -> Gaussian:
    """Return a belief that a kernel is to fill."""
    return Gaussian(np.empty(size), np.empty((size, size)))


def _matrices(
    covariance: FloatArray, observation: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return H (M, D), P (D, D) and R (M, M) as kernels take them."""
    size, rows = len(covariance), len(observation)
    return (
        shaped("an observation matrix", observation, rows, size),
        shaped("a covariance", covariance, size, size),
        shaped("a measurement covariance", noise, rows, rows),
    )


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)


def _singular(covariance: FloatArray) -> SingularMatrixError:
    return SingularMatrixError(f"an innovation's covariance has no inverse: {covariance.tolist()}")
