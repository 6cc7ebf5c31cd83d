"""Smoothers: the state at a time given what was read later too. For recordings, not for the loop."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynpf.filters import kalman
from dynpf.filters.estimate import weighted_covariance
from dynpf.filters.extended import ExtendedKalman, ExtendedKalmanParams
from dynpf.filters.kalman import Gaussian
from dynpf.motion.model import GaussianMotion
from dynpf.portable import eigh, product
from dynpf.se2 import circular_mean
from dynpf.types import FloatArray, Floats

__all__ = ["Generation", "Smoothed", "extended_rts", "fixed_lag", "rts"]

ControlT = TypeVar("ControlT")


def rts(
    filtered: Sequence[Gaussian],
    predicted: Sequence[Gaussian],
    transitions: Sequence[FloatArray],
    angles: tuple[int, ...] = (),
) -> list[Gaussian]:
    """Return the beliefs at T times given all readings (Rauch, Tung and Striebel, 1965).

    ``filtered`` holds the T beliefs after the readings of their time, ``predicted`` the T - 1 beliefs before the
    readings of the times after the first, ``transitions`` the matrices F (D, D) that led to them. Rows ``angles`` of
    the state are angles. Raises ValueError when the lengths do not fit.
    """
    if not len(predicted) == len(transitions) == len(filtered) - 1:
        raise ValueError(
            f"{len(filtered)} filtered beliefs need one prediction and one transition fewer; got {len(predicted)} and "
            f"{len(transitions)}"
        )
    smoothed = [filtered[-1]]
    for before, after, transition in zip(filtered[-2::-1], predicted[::-1], transitions[::-1], strict=True):
        smoothed.append(_rts_step(before, after, transition, smoothed[-1], angles))
    return smoothed[::-1]


def extended_rts(
    motion: GaussianMotion[ControlT],
    filtered: Sequence[Gaussian],
    controls: Sequence[ControlT],
    angles: tuple[int, ...] = (2,),
) -> list[Gaussian]:
    """Return the beliefs at T times given all readings, for a motion that is made linear at the filtered means.

    ``controls`` holds the T - 1 that led from each time to the next. Raises ValueError when the lengths do not fit.
    """
    extended = ExtendedKalman(motion, {}, ExtendedKalmanParams(angles=angles))
    steps = list(zip(filtered, controls, strict=False))
    predicted = [extended.predict(belief, control) for belief, control in steps]
    transitions = [_float64(motion.jacobian(belief.mean[:, None], control))[:, :, 0] for belief, control in steps]
    return rts(filtered, predicted, transitions, angles)


def _rts_step(
    before: Gaussian, predicted: Gaussian, transition: FloatArray, after: Gaussian, angles: tuple[int, ...]
) -> Gaussian:
    # A state without noise has a singular prediction: the pseudo-inverse learns nothing where nothing is unsure.
    weight = product(before.covariance, transition.T, _pseudo_inverse(predicted.covariance))
    mean = before.mean + product(weight, kalman.wrap_rows(after.mean - predicted.mean, angles))
    # P + G (P_after - P_predicted) G^T, as a sum of squares.
    process = predicted.covariance - product(transition, before.covariance, transition.T)
    covariance = kalman.joseph(before.covariance, weight, transition, process + after.covariance)
    return kalman.as_belief(mean, covariance, angles)


def _pseudo_inverse(covariance: FloatArray) -> FloatArray:
    """Return the inverse of a covariance (D, D), zero in the directions where that is nothing but rounding."""
    variances, directions = eigh(covariance)
    known = np.abs(variances) > len(variances) * np.finfo(np.float64).eps * np.max(np.abs(variances))
    inverses = np.where(known, 1.0, 0.0) / np.where(known, variances, 1.0)
    return product(directions * inverses, directions.T)


class Generation(NamedTuple):
    """Particles (D, N) after one step of a filter, with normalized weights (N,).

    ``ancestors`` (N,) are the columns of the generation before that they come from; None: each from its own, since
    nothing was resampled. N may change from one generation to the next where there are ancestors.
    """

    particles: Floats
    weights: Floats
    ancestors: NDArray[np.integer[Any]] | None


class Smoothed(NamedTuple):
    """Mean (D,) and covariance (D, D) at a time given later readings.

    ``distinct`` is the number of different particles of that time that have descendants: when few are left, the lag is
    too long for the number of particles and the covariance is too small.
    """

    mean: FloatArray
    covariance: FloatArray
    distinct: int


def fixed_lag(generations: Iterable[Generation], lag: int, angles: tuple[int, ...] = (2,)) -> Iterator[Smoothed]:
    """Return for each generation its moments given the readings of the ``lag`` generations that follow it.

    Each particle is replaced by its descendants, with their weights (Kitagawa, 1996). The last ``lag`` generations have
    fewer followers, the very last none. Rows ``angles`` of the particles are angles. Lag 0 is the filter. Raises
    ValueError when the lag is negative.
    """
    if lag < 0:
        raise ValueError(f"lag = {lag}: expected 0 or more generations")
    window: deque[Generation] = deque()
    for generation in generations:
        window.append(generation)
        if len(window) > lag:
            yield _smoothed(window, angles)
            window.popleft()
    while window:
        yield _smoothed(window, angles)
        window.popleft()


def _smoothed(window: Sequence[Generation], angles: tuple[int, ...]) -> Smoothed:
    """Return the moments of the first generation of the window given all in it."""
    lineage = np.arange(window[-1].weights.size)
    for generation in reversed(list(window)[1:]):
        lineage = lineage if generation.ancestors is None else generation.ancestors[lineage]
    weights = _float64(window[-1].weights)
    weights = weights / weights.sum()
    states = _float64(window[0].particles)[:, lineage]
    mean = np.sum(weights * states, axis=1)
    for row in angles:
        mean[row] = circular_mean(states[row], weights)
    deviation = kalman.wrap_rows(states - mean[:, None], angles)
    return Smoothed(mean, weighted_covariance(deviation, weights), int(np.unique(lineage).size))


def _float64(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
