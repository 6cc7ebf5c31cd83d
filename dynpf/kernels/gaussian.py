"""Gaussian beliefs: a whole step of a Kalman filter in one call, where ten of NumPy's would take longer to begin.

Everything is float64, and covariances are symmetric: of a result one half is computed and copied to the other, so that
it is symmetric to the last bit.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.linear import eliminate, multiply, substitute
from dynpf.kernels.roots import lower_root

__all__ = [
    "carry",
    "correct",
    "joseph",
    "mahalanobis",
    "offsets",
    "predict",
    "sigma_points",
    "unscented_correct",
    "unscented_expect",
    "unscented_predict",
    "weigh",
]

_TWO_PI = 2.0 * np.pi


@device
def _wrap(angle):
    return angle - _TWO_PI * np.rint(angle / _TWO_PI)


@device
def _finite(values):
    """Return whether all of ``values`` (N, M) are finite."""
    rows, columns = values.shape
    found = True
    for i in range(rows):
        for j in range(columns):
            found = found and np.isfinite(values[i, j])
    return found


@device
def _carry(matrix, covariance, noise, out):
    """Fill ``out`` (M, M) with A P A^T + N, of A (M, D), P (D, D) and N (M, M)."""
    rows, size = matrix.shape
    half = np.empty((rows, size))
    multiply(matrix, covariance, half)
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(size):
                total += half[i, k] * matrix[j, k]
            out[i, j] = total + 0.5 * (noise[i, j] + noise[j, i])
            out[j, i] = out[i, j]


@kernel
def carry(matrix, covariance, noise, out):
    """Fill ``out`` (M, M) with A P A^T + N, of ``matrix`` A (M, D), ``covariance`` P (D, D) and ``noise`` N (M, M)."""
    _carry(matrix, covariance, noise, out)


@device
def _settle(mean, covariance, angles):
    """Take the rows ``angles`` of the mean into [-pi, pi]; return whether mean and covariance are finite."""
    finite = _finite(covariance)
    for i in range(mean.size):
        finite = finite and np.isfinite(mean[i])
    for row in angles:
        if row >= mean.size:
            raise IndexError("a row of angles beyond the last row of the state")
        mean[row] = _wrap(mean[row])
    return finite


@kernel
def predict(mean, transition, covariance, noise, angles, new_mean, new_covariance):
    """Fill the belief about a state whose expectation ``mean`` (D,) is known: F P F^T + Q; return if it is finite."""
    _carry(transition, covariance, noise, new_covariance)
    for i in range(mean.size):
        new_mean[i] = mean[i]
    return _settle(new_mean, new_covariance, angles)


@device
def _mahalanobis(covariance, vector):
    """Return v^T S^-1 v, NaN where v or S is not finite, and whether S has an inverse."""
    size = vector.size
    upper, solution = covariance.copy(), vector.copy().reshape(size, 1)
    if not (_finite(upper) and _finite(solution)):
        return np.nan, True
    if not eliminate(upper, solution):
        return np.nan, False
    substitute(upper, solution)
    squared = 0.0
    for i in range(size):
        squared += vector[i] * solution[i, 0]
    return squared, True


@kernel
def mahalanobis(covariance, vector):
    """Return v^T S^-1 v of S (M, M) and v (M,), NaN where either is not finite, and whether S has an inverse."""
    return _mahalanobis(covariance, vector)


@device
def _solve_transposed(spread, cross, weight):
    """Fill ``weight`` (D, M) with C^T S^-1 of S (M, M), which is lost, and C (M, D), too; return if there is S^-1."""
    if not eliminate(spread, cross):
        return False
    substitute(spread, cross)
    for i in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            weight[i, j] = cross[j, i]
    return True


@device
def _weigh(observation, covariance, noise, weight):
    rows, size = observation.shape
    cross, spread = np.empty((rows, size)), np.empty((rows, rows))
    multiply(observation, covariance, cross)
    _carry(observation, covariance, noise, spread)
    return _solve_transposed(spread, cross, weight)


@kernel
def weigh(observation, covariance, noise, weight):
    """Fill ``weight`` (D, M) with the gain P H^T (H P H^T + R)^-1; return whether there is that inverse."""
    return _weigh(observation, covariance, noise, weight)


@device
def _joseph(weight, observation, covariance, noise, out):
    """Fill ``out`` (D, D) with (I - K H) P (I - K H)^T + K R K^T."""
    size = covariance.shape[0]
    remainder, added = np.empty((size, size)), np.empty((size, size))
    multiply(weight, observation, remainder)
    for i in range(size):
        for j in range(size):
            remainder[i, j] = (1.0 if i == j else 0.0) - remainder[i, j]
            added[i, j] = 0.0
    _carry(weight, noise, added, out)
    for i in range(size):
        for j in range(size):
            added[i, j] = out[i, j]
    _carry(remainder, covariance, added, out)


@kernel
def joseph(weight, observation, covariance, noise, out):
    """Fill ``out`` (D, D) with (I - K H) P (I - K H)^T + K R K^T, a sum of squares whatever rounding does to K."""
    _joseph(weight, observation, covariance, noise, out)


@device
def _add_product(mean, matrix, vector, out):
    """Fill ``out`` (D,) with ``mean`` plus the product of ``matrix`` (D, M) and ``vector`` (M,)."""
    for i in range(mean.size):
        total = 0.0
        for j in range(vector.size):
            total += matrix[i, j] * vector[j]
        out[i] = mean[i] + total


@kernel
def correct(mean, covariance, vector, observation, noise, angles, new_mean, new_covariance):
    """Fill the belief given an innovation ``vector`` (M,) of H (M, D) and R (M, M); return whether S has an inverse.

    The covariance is Joseph's. Whether the belief is finite is for the caller to see.
    """
    weight = np.empty((mean.size, vector.size))
    if not _weigh(observation, covariance, noise, weight):
        return False
    _add_product(mean, weight, vector, new_mean)
    _joseph(weight, observation, covariance, noise, new_covariance)
    _settle(new_mean, new_covariance, angles)
    return True


@device
def _offsets(covariance, spread, out):
    """Fill ``out`` (D, 2 D) with the columns of the root of spread P, then their negatives."""
    size = covariance.shape[0]
    lower, factor = np.empty((size, size)), np.sqrt(spread)
    if not lower_root(covariance, lower):
        return False
    for i in range(size):
        for j in range(size):
            out[i, j] = factor * lower[i, j]
            out[i, size + j] = -out[i, j]
    return True


@kernel
def offsets(covariance, spread, out):
    """Fill ``out`` (D, 2 D) with the columns of the root of spread P, then their negatives; return as ``root`` does."""
    return _offsets(covariance, spread, out)


@kernel
def sigma_points(mean, covariance, spread, offsets, points):
    """Fill ``offsets`` (D, 2 D) as the kernel of that name, and ``points`` (D, 2 D + 1): the mean, and those off it."""
    if not _offsets(covariance, spread, offsets):
        return False
    for i in range(mean.size):
        points[i, 0] = mean[i]
        for j in range(offsets.shape[1]):
            points[i, 1 + j] = mean[i] + offsets[i, j]
    return True


@device
def _differ(values, angular, spread, differences, shift):
    """Fill the differences (M, 2 D) of ``values`` (M, 2 D + 1) from their first column, and their weighted sum (M,)."""
    rows, count = differences.shape
    for i in range(rows):
        total = 0.0
        for j in range(count):
            apart = values[i, 1 + j] - values[i, 0]
            differences[i, j] = _wrap(apart) if angular[i] else apart
            total += differences[i, j]
        shift[i] = total / (2.0 * spread)


@device
def _scatter(differences, shift, spread, curvature, noise, out):
    """Fill ``out`` (M, M) with w sum d d^T + curvature s s^T + noise, w = 1 / (2 spread)."""
    rows, count = differences.shape
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for k in range(count):
                total += differences[i, k] * differences[j, k]
            scattered = total / (2.0 * spread) + curvature * (shift[i] * shift[j])
            out[i, j] = scattered + 0.5 * (noise[i, j] + noise[j, i])
            out[j, i] = out[i, j]


@kernel
def unscented_predict(moved, spread, curvature, noise, angles, new_mean, new_covariance):
    """Fill the belief that the points ``moved`` (D, 2 D + 1) and the process noise make; return if it is finite."""
    size, count = moved.shape
    differences, shift = np.empty((size, count - 1)), np.empty(size)
    angular = np.zeros(size, dtype=np.bool_)
    for row in angles:
        if row >= size:
            raise IndexError("a row of angles beyond the last row of the state")
        angular[row] = True
    _differ(moved, angular, spread, differences, shift)
    _scatter(differences, shift, spread, curvature, noise, new_covariance)
    for i in range(size):
        new_mean[i] = moved[i, 0] + shift[i]
    return _settle(new_mean, new_covariance, angles)


@kernel
def unscented_expect(innovations, angular, spread, curvature, noise, differences, shift, vector, covariance):
    """Fill the moments of the points' ``innovations`` (M, 2 D + 1): their differences (M, 2 D) from that at the mean,
    the shift (M,) of their mean from that, the innovation (M,), and its covariance (M, M).

    Returns its squared Mahalanobis distance and whether its covariance has an inverse, as ``mahalanobis`` does.
    """
    _differ(innovations, angular, spread, differences, shift)
    for i in range(vector.size):
        mean = innovations[i, 0] + shift[i]
        vector[i] = _wrap(mean) if angular[i] else mean
    _scatter(differences, shift, spread, curvature, noise, covariance)
    return _mahalanobis(covariance, vector)


@kernel
def unscented_correct(
    mean, offsets, spread, curvature, noise, differences, shift, vector, covariance, angles, new_mean, new_covariance
):
    """Fill the belief given what ``unscented_expect`` has found at the points off the mean; return if it is finite.

    As in Joseph's form its covariance is a sum of squares. The innovation's covariance must have an inverse.
    """
    rows, count = differences.shape
    size = mean.size
    cross, weight = np.empty((rows, size)), np.empty((size, rows))
    left, shifted, added = np.empty((size, count)), np.empty(size), np.zeros((size, size))
    # The innovation is the measured minus the expected: it falls where the expectation rises.
    for i in range(rows):
        for j in range(size):
            total = 0.0
            for k in range(count):
                total += differences[i, k] * offsets[j, k]
            cross[i, j] = -total / (2.0 * spread)
    _solve_transposed(covariance.copy(), cross, weight)
    multiply(weight, differences, left)
    for i in range(size):
        for j in range(count):
            left[i, j] += offsets[i, j]
    _add_product(np.zeros(size), weight, shift, shifted)
    _carry(weight, noise, added, new_covariance)
    for i in range(size):
        for j in range(size):
            added[i, j] = new_covariance[i, j]
    _scatter(left, shifted, spread, curvature, added, new_covariance)
    _add_product(mean, weight, vector, new_mean)
    return _settle(new_mean, new_covariance, angles)
