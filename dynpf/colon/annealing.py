"""A likelihood brought in by degrees, so that few particles follow a sharp one (Neal, 2001: annealed importance
sampling): each layer takes as large a share of it as leaves half of the effective particles, chooses survivors, and
sets copies apart by a kernel that keeps mean and covariance (Liu and West, 2001).
"""

import math
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from dynpf import kernels
from dynpf.colon import exact
from dynpf.filters.cloud import Cloud, effective_sample_size, gathered, weighted_cloud
from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.resampling import Indices, systematic
from dynpf.rng import Stream
from dynpf.se2 import circular_mean, wrap_angle
from dynpf.types import Floats

__all__ = ["Annealed", "annealed", "bearable_share"]

_MOST_LAYERS = 12
_KEPT = 0.5
_KERNEL = GaussianKernel(shrink=True)
# Of the survivors for what has a reserve: ten times its probability, up to a third.
_RESERVED, _MOST_RESERVED = 10.0, 1.0 / 3.0
# Measured at n = 100: with 1 and half as wide a kernel about 75 % of poses lie in their 90 % region, with these 94.5 %.
_UNCERTAIN = 1.3

EvidenceT = TypeVar("EvidenceT")


class Annealed(NamedTuple, Generic[EvidenceT]):
    """A cloud (D, n) under all of the likelihood, of which of the first particles each is a copy (n,), what the
    likelihood found at it, and how many layers it took.
    """

    cloud: Cloud
    ancestors: Indices
    evidence: EvidenceT
    layers: int


def annealed(
    cloud: Cloud,
    likelihood: Callable[[Floats, Indices], tuple[Floats, EvidenceT]],
    count: int,
    stream: Stream,
    reserve: Callable[[EvidenceT], Floats] | None = None,
) -> Annealed[EvidenceT]:
    """Weigh a cloud by a likelihood, layer by layer, each layer with ``count`` particles.

    ``likelihood`` takes particles (D, N) and their ancestors (N,), and returns log-likelihoods (N,) and what else it
    found. Up to a third of the survivors is drawn for what ``reserve`` makes of it, probabilities (N,), and weighs the
    less: so an explanation that is not likely yet keeps particles of its own. At the twelfth layer what is still left
    of the likelihood is let go: it would take an outlier for the truth.
    """
    particles, log_weights = cloud.particles, cloud.log_weights
    ancestors = np.arange(particles.shape[1], dtype=np.int32)
    left = 1.0
    for layer in range(1, _MOST_LAYERS + 1):
        log_likelihood, evidence = likelihood(particles, ancestors)
        share = bearable_share(log_weights, log_likelihood, left, _KEPT)
        weighted, _ = weighted_cloud(particles, log_weights + np.float32(share) * log_likelihood)
        left -= share
        if left <= 0.0 or layer == _MOST_LAYERS:
            break
        draws = stream.part(f"layer {layer}")
        odds = weighted.weights if reserve is None else _reserved(weighted.weights, reserve(evidence))
        chosen = systematic(odds, draws.part("resampling").uniform(), count)
        ancestors = ancestors[chosen]
        weights = weighted.weights[chosen] / odds[chosen] / count
        log_weights = exact.log(weights)
        drawn = effective_sample_size(weights)
        worth = max(1.0 / (1.0 / weighted.n_eff + 1.0 / drawn), 2.0 * _UNCERTAIN)
        particles = _inflated(
            _KERNEL.spread(gathered(particles, chosen), weighted, draws.part("kernel")), weighted, worth
        )
    return Annealed(weighted, ancestors, evidence, layer)


def _reserved(weights: Floats, probabilities: Floats) -> Floats:
    """Return odds (N,) of survival, of which more than its share is for what has these probabilities (N,)."""
    of_interest = weights * probabilities
    total = max(float(np.sum(of_interest, dtype=np.float64)), 1e-30)
    reserved = min(_RESERVED * total, _MOST_RESERVED)
    odds: Floats = np.float32(1.0 - reserved) * weights + np.float32(reserved / total) * of_interest
    return odds / np.sum(odds, dtype=np.float64).astype(np.float32)


def _inflated(particles: Floats, weighted: Cloud, worth: float) -> Floats:
    """Return particles (D, N) farther from the mean of the cloud that they were drawn from, by what so few leave out.

    The mean of ``worth`` draws is off by 1 / worth of their variance, and the variance about that mean is as much too
    small. What a layer forgets the next ones do not know of: without, the cloud would shrink to less than its error, as
    ensembles of Kalman filters do (Bocquet, 2011: an ensemble of n is worth a variance larger by 1 + 1 / n).
    """
    mean = np.asarray(np.sum(weighted.weights * weighted.particles, axis=1, dtype=np.float64))
    mean[2] = circular_mean(weighted.particles[2], weighted.weights)
    deviation = particles - mean[:, None]
    deviation[2] = wrap_angle(deviation[2])
    inflated: Floats = (mean[:, None] + math.sqrt((worth + _UNCERTAIN) / (worth - _UNCERTAIN)) * deviation).astype(
        particles.dtype
    )
    return inflated


def bearable_share(log_weights: Floats, log_likelihood: Floats, left: float, kept: float) -> float:
    """Return the largest share, up to ``left``, of log-likelihoods (N,) that leaves N_eff at ``kept`` of N."""
    bearable: float = kernels.colon.bearable(log_weights, log_likelihood, left, kept)
    # Weights that were as thin to begin with bear nothing: a little is taken, and resampling evens them out.
    return max(bearable, 1e-3 * left)
