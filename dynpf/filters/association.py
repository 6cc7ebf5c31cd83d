"""Which measurement belongs to which object: gated nearest neighbours in order of likelihood."""

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["associate"]


def associate(costs: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return for each object the index of its measurement, or -1; no measurement is given twice.

    ``costs`` has shape (objects, measurements): negative log-likelihoods, infinite where the gate is closed. The
    cheapest pair is taken first, the lower indices on a tie. For objects that keep farther apart than their gates are
    wide, such as discs, this is the jointly cheapest assignment.
    """
    remaining = costs.copy()
    assigned = np.full(costs.shape[0], -1, dtype=np.intp)
    for _ in range(min(costs.shape)):
        chosen, measurement = divmod(int(remaining.argmin()), costs.shape[1])
        if not math.isfinite(remaining[chosen, measurement]):
            break
        assigned[chosen] = measurement
        remaining[chosen, :] = np.inf
        remaining[:, measurement] = np.inf
    return assigned
