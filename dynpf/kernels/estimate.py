"""Mean and covariance of weighted poses.

Sums are taken in float64 over lanes of fixed number and order, so that they become vectors and still give the same bits
everywhere.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import atan2, sincos, wrap

__all__ = ["pose_moments", "scatter"]

_LANES = 128
_f, _d = np.float32, np.float64
_ONE = _d(1.0)


@device
def _add(lanes, weights, values):
    """Add weights times values, both (n,), to the first n lanes: n sums that do not wait for one another."""
    for j in range(weights.size):
        lanes[j] += _d(weights[j]) * _d(values[j])


@device
def _total(lanes):
    """Return the sum of the lanes, folded half onto half."""
    half = _LANES // 2
    while half > 0:
        for j in range(half):
            lanes[j] += lanes[half + j]
        half //= 2
    return lanes[0]


@kernel
def pose_moments(x, y, theta, weights, mean, covariance):
    """Write the mean (3,) and covariance (3, 3), float64, of poses whose coordinates and weights are (N,) float32.

    The weights need not sum to one. Returns whether the result is finite; it is not where the weights' sum is zero or a
    weight or coordinate is not finite.
    """
    count = x.size
    values = np.ones((5, _LANES), dtype=np.float32)
    weighted = np.empty((3, _LANES), dtype=np.float32)
    lanes = np.zeros((5, _LANES))
    for start in range(0, count, _LANES):
        size = min(_LANES, count - start)
        weight, heading = weights[start : start + size], theta[start : start + size]
        from_x, from_y = x[start : start + size], y[start : start + size]
        for j in range(size):
            values[1, j], values[2, j] = from_x[j], from_y[j]
            values[3, j], values[4, j] = sincos(heading[j])
        for row in range(5):
            _add(lanes[row], weight, values[row])
    for row in range(5):
        lanes[row, 0] = _total(lanes[row])
    scale = _ONE / lanes[0, 0]
    mean[0], mean[1] = lanes[1, 0] * scale, lanes[2, 0] * scale
    mean_theta = atan2(_f(lanes[3, 0] * scale), _f(lanes[4, 0] * scale))
    mean[2] = mean_theta

    # Deviations are taken from the mean rounded to float32, exactly for particles near it; what the rounding adds to
    # the covariance is taken off again below.
    mean_x, mean_y = _f(mean[0]), _f(mean[1])
    off_x, off_y = mean[0] - _d(mean_x), mean[1] - _d(mean_y)
    sums = np.zeros((9, _LANES))
    for start in range(0, count, _LANES):
        size = min(_LANES, count - start)
        weight, heading = weights[start : start + size], theta[start : start + size]
        from_x, from_y = x[start : start + size], y[start : start + size]
        for j in range(size):
            values[0, j], values[1, j] = from_x[j] - mean_x, from_y[j] - mean_y
            values[2, j] = wrap(heading[j] - mean_theta)
        for row in range(3):
            for j in range(size):
                weighted[row, j] = weight[j] * values[row, j]
            for column in range(row + 1):
                _add(sums[3 * row + column], weighted[row, :size], values[column])
    for row in range(3):
        for column in range(row + 1):
            covariance[row, column] = covariance[column, row] = _total(sums[3 * row + column]) * scale
    covariance[0, 0] -= off_x * off_x
    covariance[1, 0] -= off_x * off_y
    covariance[0, 1] -= off_x * off_y
    covariance[1, 1] -= off_y * off_y
    # A sum that is finite has finite terms.
    return np.isfinite(mean[0] + mean[1] + covariance[0, 0] + covariance[1, 1] + covariance[2, 2])


@device
def _add_products(lanes, weights, first, second):
    """Add weights times first times second, each (n,), to the first n lanes."""
    for j in range(weights.size):
        lanes[j] += (_d(weights[j]) * _d(first[j])) * _d(second[j])


@kernel
def scatter(deviation, weights, out):
    """Write sum w d d^T of ``deviation`` d (D, N) and ``weights`` w (N,) to ``out`` (D, D), of either precision."""
    size, count = deviation.shape
    lanes = np.empty(_LANES)
    for row in range(size):
        for column in range(row + 1):
            for j in range(_LANES):
                lanes[j] = 0.0
            first, second = deviation[row], deviation[column]
            for start in range(0, count, _LANES):
                stop = min(start + _LANES, count)
                _add_products(lanes, weights[start:stop], first[start:stop], second[start:stop])
            out[row, column] = out[column, row] = _total(lanes)
