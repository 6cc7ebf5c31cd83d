"""A weighted set of particles: the belief of a particle filter."""

import math
from typing import NamedTuple

import numpy as np

from dynpf import kernels
from dynpf.portable import log
from dynpf.types import Floats

__all__ = ["Cloud", "effective_sample_size", "gathered", "normalized_weights", "uniform_cloud", "weighted_cloud"]


class Cloud(NamedTuple):
    """Particles (D, N) with float32 weights (N,) that sum to one, and their logarithms.

    ``moved`` tells whether the robot has moved since the cloud was last resampled, and ``memory`` is what the filter's
    recovery remembers: plain numbers, so that a cloud holds all of a filter's state.
    """

    particles: Floats
    weights: Floats
    log_weights: Floats
    n_eff: float
    moved: bool = False
    memory: tuple[float, ...] = ()


def uniform_cloud(particles: Floats, memory: tuple[float, ...] = ()) -> Cloud:
    """Return the particles (D, N) at equal weights; raises ValueError when there are none."""
    count = particles.shape[1]
    if count == 0:
        raise ValueError(f"a cloud needs at least one particle; got shape {particles.shape}")
    weights, log_weights = np.empty((2, count), dtype=np.float32)
    weights.fill(1.0 / count)
    log_weights.fill(-log(float(count)))
    return Cloud(particles, weights, log_weights, float(count), False, memory)


def weighted_cloud(particles: Floats, log_weights: Floats) -> tuple[Cloud, float]:
    """Return the cloud of log-weights (N,) that need not be normalized, and the log of the sum of their exponentials.

    A NaN counts as an impossible particle. Where every particle is impossible none is to be preferred: the
    weights are equal and the log-sum is -inf. Particles at +inf share all of the weight.
    """
    count = log_weights.size
    if count == 0:
        raise ValueError(f"a cloud needs at least one particle; got shape {particles.shape}")
    # Large numbers are brought close to zero before they are rounded to float32.
    shift = 0.0
    shifted = log_weights
    if log_weights.dtype != np.float32:
        shift = _largest(log_weights)
        shifted = (log_weights - shift).astype(np.float32)
    weights = np.empty(count, dtype=np.float32)
    largest, total, squares = kernels.cloud.normalize(shifted, weights)
    if largest == math.inf:
        winners = np.where(np.isposinf(shifted), np.float32(0.0), np.float32(-math.inf))
        return weighted_cloud(particles, winners)[0], math.inf
    if total == 0.0:
        return uniform_cloud(particles), -math.inf
    log_sum = float(largest) + log(total)
    normalized = shifted - np.float32(log_sum)
    return Cloud(particles, weights, normalized, total * total / squares), shift + log_sum


def normalized_weights(log_weights: Floats) -> tuple[Floats, float]:
    """Return weights (N,) float32 that sum to one and the log-sum, by the rules of ``weighted_cloud``."""
    cloud, log_sum = weighted_cloud(np.empty((0, log_weights.size), dtype=np.float32), log_weights)
    return cloud.weights, log_sum


def effective_sample_size(weights: Floats) -> float:
    """Return 1 / sum(w^2) of normalized weights: N if all are equal, 1 if one has all (PARTS eq. 3.24)."""
    return 1.0 / float(np.sum(np.square(weights, dtype=np.float64)))


def gathered(particles: Floats, chosen: np.ndarray[tuple[int], np.dtype[np.int32]]) -> Floats:
    """Return the chosen columns (M,) of particles (D, N), shape (D, M)."""
    survivors = np.empty((particles.shape[0], chosen.size), dtype=particles.dtype)
    kernels.cloud.gather(particles, chosen, survivors)
    return survivors


def _largest(log_weights: Floats) -> float:
    finite = log_weights[np.isfinite(log_weights)]
    return float(finite.max()) if finite.size else 0.0
