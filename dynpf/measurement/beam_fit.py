"""Parameters of the beam model from readings: expectation maximization over which part of the mixture each came from.

Thrun, Burgard and Fox, Probabilistic Robotics (2005), section 6.3.3 (learn_intrinsic_parameters).
"""

import math
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from dynpf.measurement.beam import BeamParams, densities, share_within
from dynpf.params import validated
from dynpf.portable import exp, expm1, log
from dynpf.types import FloatArray

__all__ = ["BeamFit", "fit_beam"]

SIGMA_LEAST = 1e-4  # m: where every hit is exact there is no other end
LAMBDA_LEAST, LAMBDA_MOST = 1e-6, 1e4  # 1/m


class BeamFit(NamedTuple):
    """What was learned: ``params``, and the log-likelihood of the readings at the start and after each iteration.

    ``used``: the number of pairs. ``converged``: whether the last iteration gained less than asked for.
    """

    params: BeamParams
    log_likelihoods: FloatArray
    used: int
    converged: bool


def fit_beam(
    ranges: ArrayLike,
    expected: ArrayLike,
    range_max: float,
    start: BeamParams,
    *,
    tolerance: float = 1e-8,
    max_iterations: int = 1000,
) -> BeamFit:
    """Return ``start`` with the shares, sigma_hit and lambda_short that make the readings likeliest, near it.

    ``ranges`` and ``expected``, of one shape: readings, and the lengths of rays from the poses where they were taken,
    metres. Pairs that are not numbers, readings below zero, and pairs without a wall in reach (expected >= range_max)
    or at length zero are left out; a reading beyond ``range_max`` counts as that. Stops when an iteration gains less
    than ``tolerance`` per pair.

    Differs from the book in two ways, without which the likelihood could fall: responsibilities carry the shares, and
    the truncation of p_hit and p_short is accounted for. A part that explains no reading keeps its scale, and one whose
    share is zero at the start keeps that. sigma_hit is no less than 1e-4 m.

    Raises ValueError where the shapes differ, no pair is left, ``range_max`` is not finite and positive, or ``start``
    makes a reading impossible.
    """
    params = validated(start)
    z, length = _pairs(ranges, expected, range_max)
    shares = np.array([params.z_hit, params.z_short, params.z_max, params.z_rand])
    sigma, decay = params.sigma_hit, params.lambda_short
    history: list[float] = []
    converged = False
    while True:
        parts = shares[:, None] * densities(z, length, range_max, sigma, decay)
        total = np.sum(parts, axis=0)
        if not (total > 0.0).all():
            raise ValueError(f"fit_beam: range {z[np.argmin(total)]} m is impossible under the parameters {params}")
        history.append(float(np.sum(log(total))))
        converged = len(history) > 1 and history[-1] - history[-2] < tolerance * z.size
        if converged or len(history) > max_iterations:
            break
        responsibility = parts / total
        shares = np.mean(responsibility, axis=1)
        sigma = _sigma_hit(responsibility[0], z, length, range_max, sigma)
        decay = _lambda_short(responsibility[1], z, length, decay)
        shares /= np.sum(shares)
    z_hit, z_short, z_max, z_rand = shares.tolist()
    learned = msgspec.structs.replace(
        params, z_hit=z_hit, z_short=z_short, z_max=z_max, z_rand=z_rand, sigma_hit=sigma, lambda_short=decay
    )
    return BeamFit(learned, np.array(history), z.size, converged)


def _pairs(ranges: ArrayLike, expected: ArrayLike, range_max: float) -> tuple[FloatArray, FloatArray]:
    z, length = np.asarray(ranges, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    if z.shape != length.shape:
        raise ValueError(f"fit_beam: ranges {z.shape} and expected {length.shape} must have one shape")
    if not (math.isfinite(range_max) and range_max > 0.0):
        raise ValueError(f"fit_beam: range_max = {range_max} must be finite and above 0")
    usable = (z >= 0.0) & (length > 0.0) & (length < range_max)
    if not usable.any():
        raise ValueError(f"fit_beam: of {z.size} pairs none has a reading, and a wall within {range_max} m")
    return np.minimum(z[usable], range_max), length[usable]


def _sigma_hit(share: FloatArray, z: FloatArray, length: FloatArray, range_max: float, sigma: float) -> float:
    """Return the next sigma_hit, given how much of each reading is a hit.

    Truncation is undone by expectation, too: for each reading seen, as many were thrown away outside [0, range_max] as
    the Gaussian has there, with their mean square error.
    """
    low, high = -length / sigma, (range_max - length) / sigma
    within = share_within(low, high)
    # The integral of t^2 phi(t) outside [low, high] is 1 - within + high phi(high) - low phi(low).
    edges = (high * exp(-0.5 * (high * high)) - low * exp(-0.5 * (low * low))) / math.sqrt(2.0 * math.pi)
    thrown_away = sigma * sigma * (1.0 - within + edges) / within
    count = float(np.sum(share / within))
    if count < 1e-9:
        return sigma
    return max(math.sqrt(float(np.sum(share * (np.square(z - length) + thrown_away))) / count), SIGMA_LEAST)


def _lambda_short(share: FloatArray, z: FloatArray, length: FloatArray, decay: float) -> float:
    """Return the next lambda_short, given how much of each reading is too short; truncation as for sigma_hit."""
    before = -expm1(-decay * length)
    beyond = exp(-decay * length) / before
    count = float(np.sum(share / before))
    metres = float(np.sum(share * (z + beyond * (length + 1.0 / decay))))
    if count < 1e-9:
        return decay
    return min(max(count / max(metres, 1e-300), LAMBDA_LEAST), LAMBDA_MOST)
