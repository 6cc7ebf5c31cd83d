"""Weights, survivors and their copies, for ``dynpf.kernels.cloud``."""

import numpy as np
from numpy.typing import NDArray

from dynpf.types import FloatArray

__all__ = ["normalized", "systematic"]


def normalized(log_weights: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the weights (N,) of finite log-weights, the log of the sum of their exponentials, and N_eff."""
    largest = np.max(log_weights)
    scaled = np.exp(log_weights - largest)
    weights = scaled / np.sum(scaled)
    return weights, float(largest + np.log(np.sum(scaled))), float(1.0 / np.sum(weights**2))


def systematic(weights: FloatArray, uniform: float, count: int) -> NDArray[np.intp]:
    """Return for each tooth of the comb the first particle at which the cumulative weights exceed it."""
    cumulative = np.cumsum(weights)
    comb = (np.arange(count) + uniform) * (cumulative[-1] / count)
    chosen: NDArray[np.intp] = np.searchsorted(cumulative, np.minimum(comb, np.nextafter(cumulative[-1], 0.0)), "right")
    return chosen
