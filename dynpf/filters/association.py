"""Which measurement belongs to which object: all of them decided jointly."""

import math

import numpy as np
from numpy.typing import NDArray

from dynpf.assignment import assign

__all__ = ["associate"]


def associate(costs: NDArray[np.float64], missed: float = math.inf) -> NDArray[np.intp]:
    """Return for each object the index of its measurement, or -1; no measurement is given twice.

    ``costs`` has shape (objects, measurements): negative log-likelihoods, infinite where the gate is closed. An object
    without a measurement costs ``missed``; with an infinite one as many objects as possible have a measurement. The
    sum is the least (global nearest neighbours; Blackman and Popoli 1999, section 6.4).
    """
    objects, measurements = costs.shape
    if not costs.size:
        return np.full(objects, -1, dtype=np.intp)
    favourite = costs.argmin(axis=1)
    least = costs[np.arange(objects), favourite]
    favourite = np.where(least < missed, favourite, -1)
    taken = favourite[favourite >= 0]
    if len(np.unique(taken)) == len(taken):  # nobody stands in another's way
        return favourite
    if math.isinf(missed):
        possible = costs[np.isfinite(costs)]
        missed = 1.0 + (1 + min(costs.shape)) * float(possible.max() - possible.min()) + float(possible.max())
    own = np.where(np.eye(objects, dtype=bool), missed, np.inf)
    chosen = assign(np.hstack([costs, own]))
    return np.where(chosen < measurements, chosen, -1)
