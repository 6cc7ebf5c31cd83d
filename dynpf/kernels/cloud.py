"""What a filter does with all of its particles at once: normalize their weights, choose survivors, copy them.

Sums are taken in float64 over lanes of fixed number and order, so that they become vectors and still give the same bits
everywhere.
"""

import numpy as np

from dynpf.kernels.compiler import kernel
from dynpf.kernels.elementary import exp

__all__ = ["gather", "normalize", "systematic"]

_LANES = 16
_f = np.float32
_LOWEST = _f(-np.inf)
_ONE, _ZERO = np.float64(1.0), np.float64(0.0)


@kernel
def normalize(log_weights, weights):
    """Write exp(log_weights) over its sum to ``weights``, both (N,) float32; return the largest log-weight, the sum of
    exp(log-weight - largest), and the sum of its squares.

    A NaN counts as -inf. When the largest is infinite or there is none, nothing is written.
    """
    count = log_weights.size
    whole = count - count % _LANES
    lanes = np.empty(_LANES, dtype=np.float32)
    for j in range(_LANES):
        lanes[j] = _LOWEST
    for start in range(0, whole, _LANES):
        for j in range(_LANES):
            value = log_weights[start + j]
            lanes[j] = value if value > lanes[j] else lanes[j]
    largest = _LOWEST
    for j in range(_LANES):
        largest = lanes[j] if lanes[j] > largest else largest
    for i in range(whole, count):
        largest = log_weights[i] if log_weights[i] > largest else largest
    if not np.isfinite(largest):
        return largest, _ZERO, _ZERO

    for i in range(count):
        value = log_weights[i] - largest
        weights[i] = exp(value if value <= _f(0.0) else _LOWEST)
    sums = np.zeros(_LANES)
    squares = np.zeros(_LANES)
    for start in range(0, whole, _LANES):
        for j in range(_LANES):
            weight = np.float64(weights[start + j])
            sums[j] += weight
            squares[j] += weight * weight
    total, square = _ZERO, _ZERO
    for j in range(_LANES):
        total += sums[j]
        square += squares[j]
    for i in range(whole, count):
        weight = np.float64(weights[i])
        total += weight
        square += weight * weight
    scale = _f(_ONE / total)
    for i in range(count):
        weights[i] *= scale
    return largest, total, square


@kernel
def systematic(weights, uniform, chosen):
    """Write the survivors of a comb of chosen.size teeth through the cumulative weights to ``chosen``, ascending.

    Without a branch on the weights, whose outcome a processor could not foresee: each particle writes its index where
    its first copy would stand, one without copies is overwritten by the next, and a running maximum fills the rest.
    Returns False, nothing chosen, when the weights' sum is not positive and finite.
    """
    count, teeth = weights.size, chosen.size
    total = _ZERO
    for i in range(count):
        total += np.float64(weights[i])
    if not (np.isfinite(total) and total > _ZERO) or teeth == 0:
        return teeth == 0
    for k in range(teeth):
        chosen[k] = 0
    most = np.float64(teeth)
    per_weight = most / total
    cumulative, tooth = _ZERO, 0
    for i in range(count):
        if tooth < teeth:
            chosen[tooth] = i
        cumulative += np.float64(weights[i])
        after = np.int64(min(max(_ZERO, np.ceil(cumulative * per_weight - uniform)), most))
        tooth = teeth if cumulative >= total else min(max(after, tooth), teeth)
    last = chosen[0]
    for k in range(teeth):
        last = max(last, chosen[k])
        chosen[k] = last
    return True


@kernel
def gather(particles, chosen, survivors):
    """Copy the chosen columns (M,) of particles (D, N) to ``survivors`` (D, M)."""
    for row in range(particles.shape[0]):
        for k in range(chosen.size):
            survivors[row, k] = particles[row, chosen[k]]
