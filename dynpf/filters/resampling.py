"""Importance weights: log-domain normalization, effective sample size and systematic resampling."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["effective_sample_size", "normalize_log_weights", "systematic"]

FloatArray = NDArray[np.float64]


def normalize_log_weights(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Return the normalized weights, shape (N,), and the log of the sum of the unnormalized ones.

    A NaN counts as an impossible particle (log-weight -inf). When every particle is impossible, the
    measurement says nothing about which to prefer: the weights are uniform and the log-sum is -inf, which
    a caller tests to recognize a lost filter. Particles at +inf share all of the weight. Raises ValueError
    when there are no particles.
    """
    if log_weights.size == 0:
        raise ValueError("normalize_log_weights: no particles (shape (0,)); at least one is needed")
    usable = np.where(np.isnan(log_weights), -np.inf, log_weights)
    largest = float(usable.max())
    if np.isneginf(largest):
        return np.full(usable.shape, 1.0 / usable.size), -np.inf
    if np.isposinf(largest):
        winners = np.isposinf(usable)
        return winners / np.count_nonzero(winners), np.inf
    scaled = np.exp(usable - largest)
    total = float(scaled.sum())
    return scaled / total, largest + float(np.log(total))


def effective_sample_size(weights: FloatArray) -> float:
    """Return 1 / sum(w^2) of normalized weights: N if all are equal, 1 if one has all (PARTS eq. 3.24)."""
    return 1.0 / float(np.sum(weights * weights))


def systematic(weights: FloatArray, uniform: float, count: int | None = None) -> NDArray[np.intp]:
    """Return the indices of the particles that survive, ascending, shape (count,) (PARTS appendix B).

    One number ``uniform`` in [0, 1) places a comb of ``count`` (default: N) equidistant teeth on the
    cumulative weights: particle i is taken floor(count w_i) or ceil(count w_i) times, count w_i in the
    mean. A particle of weight zero is never taken. The weights need not be normalized; raises ValueError
    when their sum is not positive and finite.
    """
    teeth = weights.size if count is None else count
    cumulative = np.cumsum(weights)
    total = float(cumulative[-1]) if weights.size else 0.0
    if not (np.isfinite(total) and total > 0.0):
        raise ValueError(f"systematic: the weights sum to {total}; a positive finite sum is needed")
    # The last tooth may round up to the total itself, which lies beyond the last particle.
    comb = np.minimum((np.arange(teeth) + uniform) * (total / teeth), np.nextafter(total, 0.0))
    indices: NDArray[np.intp] = np.searchsorted(cumulative, comb, side="right")
    return indices
