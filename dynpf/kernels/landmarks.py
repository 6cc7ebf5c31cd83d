"""Likelihood of ranges and bearings to point landmarks: each of many readings against each of many poses.

Poses (3, N) are x, y, theta, float32. Readings (K,) are of ``landmarks``, int64, with ``ranges`` and ``bearings``,
float32. The map has ``ids`` (M,), int64, at ``positions`` (2, M), float32: east and north. ``noise`` (6,), float64, is
the values of ``dynpf.measurement.range_bearing.SightingNoise``: a call with tuples costs four times as much.
"""

import numpy as np

from dynpf.kernels import elementary64
from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import atan2, exp, log, wrap
from dynpf.kernels.philox import BLOCK

__all__ = ["distances", "innovations", "log_likelihood", "log_likelihood_unlabelled", "slopes"]

_f = np.float32
_hypot, _direction = elementary64.hypot, elementary64.atan2
_WHOLE_TURN, _NEAREST = 2.0 * np.pi, 1e-300
_HALF, _ONE, _TWO_PI, _INFINITY = _f(0.5), _f(1.0), _f(2.0 * np.pi), _f(np.inf)
_LARGEST, _LN_2 = _f(3.0e38), _f(0.6931471805599453)
# Places in ``noise``.
_SIGMA_RANGE, _SIGMA_RANGE_PER_M, _SIGMA_BEARING, _OUTLIERS, _OUTLIER_RANGE, _TEMPERING = range(6)
_FRACTION, _EXPONENT_ONE = np.int32(0x007FFFFF), np.int32(0x3F800000)


@device
def _column(identity, ids):
    """Return where an identity stands among ``ids``, -1 if it does not."""
    found = -1
    for m in range(ids.size):
        if ids[m] == identity:
            found = m
    return found


@device
def _block(row, start):
    """Return a block of a row as an array of its own: the compiler then knows that neighbours lie side by side."""
    return row[start : start + BLOCK]


@device
def _informs(distance, bearing):
    """Return whether a reading is finite."""
    return abs(distance) < _INFINITY and abs(bearing) < _INFINITY


@device
def _finite(x, y, theta):
    return abs(x) + abs(y) + abs(theta) < _INFINITY


@device
def _expected(x, y, theta, east, north):
    """Return the range, and the bearing up to whole turns, at which a pose sees the landmark at (east, north)."""
    along, across = east - x, north - y
    return np.sqrt(along * along + across * across), atan2(across, along) - theta


@device
def _range_variance(distance, sigma_range, sigma_range_per_m):
    base, growing = _f(sigma_range), _f(sigma_range_per_m) * distance
    return base * base + growing * growing


@device
def _half_square(far, turned, range_scale, bearing_scale):
    """Return half the squared deviation of a reading in standard deviations, not infinite."""
    short = wrap(turned)
    return min(range_scale * far * far + bearing_scale * short * short, _LARGEST)


@kernel
def log_likelihood(poses, landmarks, ranges, bearings, ids, positions, noise, out):
    """Fill ``out`` (N,) with the tempered log-density of the readings (K,) at poses.

    A reading that is not finite, or of no landmark in the map, counts as nothing; a pose that is not finite is
    impossible.
    """
    x, y, theta, easts, norths = poses[0], poses[1], poses[2], positions[0], positions[1]
    sigma_range, sigma_range_per_m = noise[_SIGMA_RANGE], noise[_SIGMA_RANGE_PER_M]
    sigma_bearing, outliers, tempering = _f(noise[_SIGMA_BEARING]), _f(noise[_OUTLIERS]), _f(noise[_TEMPERING])
    bearing_scale = _HALF / (sigma_bearing * sigma_bearing)
    floor = outliers / (_f(noise[_OUTLIER_RANGE]) * _TWO_PI)
    total, product = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    half_square, exponent = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.int32)
    for start in range(0, x.size, BLOCK):
        size = min(BLOCK, x.size - start)
        px, py, heading = _block(x, start), _block(y, start), _block(theta, start)
        total[:size], product[:size], exponent[:size] = _f(0.0), _ONE, np.int32(0)
        for k in range(ranges.size):
            m = _column(landmarks[k], ids)
            distance, bearing = ranges[k], bearings[k]
            if m < 0 or not _informs(distance, bearing):
                continue
            east, north = easts[m], norths[m]
            variance = _range_variance(distance, sigma_range, sigma_range_per_m)
            range_scale = _HALF / variance
            peak = (_ONE - outliers) / (_TWO_PI * np.sqrt(variance) * sigma_bearing)
            if floor > _f(0.0):
                for i in range(size):
                    expected, direction = _expected(px[i], py[i], heading[i], east, north)
                    half_square[i] = _half_square(distance - expected, bearing - direction, range_scale, bearing_scale)
                for i in range(size):
                    density = peak * exp(-half_square[i]) + floor
                    # A product of densities takes one logarithm for all of them, its exponent kept apart.
                    bits = _f(product[i] * density).view(np.int32)
                    product[i] = np.int32((bits & _FRACTION) | _EXPONENT_ONE).view(np.float32)
                    exponent[i] += np.int32(np.int32(bits >> np.int32(23)) - np.int32(127))
            else:
                log_peak = log(peak)
                for i in range(size):
                    expected, direction = _expected(px[i], py[i], heading[i], east, north)
                    total[i] += log_peak - _half_square(
                        distance - expected, bearing - direction, range_scale, bearing_scale
                    )
        for i in range(size):
            whole = tempering * (total[i] + (log(product[i]) + _f(exponent[i]) * _LN_2))
            out[start + i] = whole if _finite(px[i], py[i], heading[i]) else -_INFINITY


@kernel
def distances(poses, weights, landmarks, ranges, bearings, ids, positions, noise, out):
    """Fill ``out`` (K,), float64, with the squared Mahalanobis distance of each reading's mean innovation.

    Mean and covariance are those of the poses under ``weights`` (N,); the reading's noise is added to the covariance.
    NaN for a reading that is not finite or of no landmark in the map.
    """
    x, y, theta, easts, norths = poses[0], poses[1], poses[2], positions[0], positions[1]
    sigma_range, sigma_range_per_m = noise[_SIGMA_RANGE], noise[_SIGMA_RANGE_PER_M]
    sigma_bearing = noise[_SIGMA_BEARING]
    total = np.float64(0.0)
    for i in range(x.size):
        total += np.float64(weights[i])
    lanes = min(BLOCK, x.size)
    # Each lane has sums of its own, so that neighbouring particles are added at once and yet in a fixed order.
    sums = np.empty((5, BLOCK))
    far, turned = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    for k in range(ranges.size):
        out[k] = np.nan
        m = _column(landmarks[k], ids)
        distance, bearing = ranges[k], bearings[k]
        if m < 0 or not _informs(distance, bearing):
            continue
        sums[:, :lanes] = 0.0
        east, north = easts[m], norths[m]
        for start in range(0, x.size, BLOCK):
            size = min(BLOCK, x.size - start)
            px, py, heading = _block(x, start), _block(y, start), _block(theta, start)
            for i in range(size):
                expected, direction = _expected(px[i], py[i], heading[i], east, north)
                far[i] = distance - expected
                turned[i] = wrap(bearing - direction)
            _add_moments(sums, far[:size], turned[:size], _block(weights, start))
        mean_far, mean_turned, square_far, mixed, square_turned = _moments(sums[:, :lanes], total)
        variance_far = square_far - mean_far * mean_far
        covariance = mixed - mean_far * mean_turned
        variance_turned = square_turned - mean_turned * mean_turned
        variance_far += np.float64(_range_variance(distance, sigma_range, sigma_range_per_m))
        variance_turned += sigma_bearing * sigma_bearing
        out[k] = (
            variance_turned * mean_far * mean_far
            - 2.0 * covariance * mean_far * mean_turned
            + variance_far * mean_turned * mean_turned
        ) / (variance_far * variance_turned - covariance * covariance)


@device
def _add_moments(sums, far, turned, weights):
    first, second, third, fourth, fifth = sums[0], sums[1], sums[2], sums[3], sums[4]
    for lane in range(far.size):
        a, b = np.float64(far[lane]), np.float64(turned[lane])
        weight_a, weight_b = np.float64(weights[lane]) * a, np.float64(weights[lane]) * b
        first[lane] += weight_a
        second[lane] += weight_b
        third[lane] += weight_a * a
        fourth[lane] += weight_a * b
        fifth[lane] += weight_b * b


@device
def _moments(sums, total):
    a, b, c, d, e = 0.0, 0.0, 0.0, 0.0, 0.0
    for lane in range(sums.shape[1]):
        a += sums[0, lane]
        b += sums[1, lane]
        c += sums[2, lane]
        d += sums[3, lane]
        e += sums[4, lane]
    return a / total, b / total, c / total, d / total, e / total


@device
def _lower(best, distance, bearing, far, turn, range_scale, bearing_scale):
    """Lower ``best`` to the half squares of a reading of one landmark where they are smaller."""
    for i in range(best.size):
        best[i] = min(best[i], _half_square(distance - far[i], bearing - turn[i], range_scale, bearing_scale))


@device
def _add_shares(share, best, distance, bearing, far, turn, range_scale, bearing_scale):
    """Add to ``share`` the likelihood of one landmark as a part of that of the best, which cannot underflow."""
    for i in range(share.size):
        share[i] += exp(best[i] - _half_square(distance - far[i], bearing - turn[i], range_scale, bearing_scale))


@device
def _add_log(total, best, share, peak, floor):
    """Add to ``total`` the logarithm of peak share exp(-best) + floor, which without a floor cannot underflow."""
    if floor > _f(0.0):
        for i in range(total.size):
            total[i] += log(peak * share[i] * exp(-best[i]) + floor)
    else:
        log_peak = log(peak)
        for i in range(total.size):
            total[i] += (log_peak + log(share[i])) - best[i]


@kernel
def log_likelihood_unlabelled(poses, readings, positions, mixture, noise, out):
    """Fill ``out`` (N,) with the tempered log-density of readings of any of the landmarks, M at least 1.

    ``readings`` (2, K), float32: ranges and bearings. Of the landmarks' densities, the greatest is taken, or with
    ``mixture`` the mean. A reading that is not finite counts as nothing; a pose that is not finite is impossible.
    """
    x, y, theta = poses[0], poses[1], poses[2]
    ranges, bearings, easts, norths = readings[0], readings[1], positions[0], positions[1]
    sigma_range, sigma_range_per_m = noise[_SIGMA_RANGE], noise[_SIGMA_RANGE_PER_M]
    sigma_bearing, outliers, tempering = _f(noise[_SIGMA_BEARING]), _f(noise[_OUTLIERS]), _f(noise[_TEMPERING])
    count = easts.size
    bearing_scale = _HALF / (sigma_bearing * sigma_bearing)
    floor = outliers / (_f(noise[_OUTLIER_RANGE]) * _TWO_PI)
    expected = np.empty((count, BLOCK), dtype=np.float32)
    direction = np.empty((count, BLOCK), dtype=np.float32)
    best, share = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    total = np.empty(BLOCK, dtype=np.float32)
    for start in range(0, x.size, BLOCK):
        size = min(BLOCK, x.size - start)
        px, py, heading = _block(x, start), _block(y, start), _block(theta, start)
        for m in range(count):
            far, turn = expected[m], direction[m]
            for i in range(size):
                far[i], turn[i] = _expected(px[i], py[i], heading[i], easts[m], norths[m])
        total[:size] = _f(0.0)
        for k in range(ranges.size):
            distance, bearing = ranges[k], bearings[k]
            if not _informs(distance, bearing):
                continue
            variance = _range_variance(distance, sigma_range, sigma_range_per_m)
            range_scale = _HALF / variance
            peak = (_ONE - outliers) / (_TWO_PI * np.sqrt(variance) * sigma_bearing)
            best[:size], share[:size] = _LARGEST, _ONE
            for m in range(count):
                _lower(best[:size], distance, bearing, expected[m], direction[m], range_scale, bearing_scale)
            if mixture:
                share[:size] = _f(0.0)
                for m in range(count):
                    _add_shares(
                        share[:size], best, distance, bearing, expected[m], direction[m], range_scale, bearing_scale
                    )
                for i in range(size):
                    share[i] /= _f(count)
            _add_log(total[:size], best, share, peak, floor)
        for i in range(size):
            out[start + i] = tempering * total[i] if _finite(px[i], py[i], heading[i]) else -_INFINITY


@kernel
def innovations(states, easts, norths, ranges, bearings, bias_row, scale_row, out):
    """Fill ``out`` (2 K, N) with ranges and bearings (K,) less what ``states`` (D, N) expect, bearings the short way.

    Landmarks are at ``easts`` and ``norths`` (K,). Rows of the states are added to bearings and multiply ranges, if
    they are not negative. Everything is float64.
    """
    for k in range(ranges.size):
        for i in range(states.shape[1]):
            along, across = easts[k] - states[0, i], norths[k] - states[1, i]
            scale = states[scale_row, i] if scale_row >= 0 else 1.0
            bias = states[bias_row, i] if bias_row >= 0 else 0.0
            out[2 * k, i] = ranges[k] - scale * _hypot(along, across)
            turned = bearings[k] - _direction(across, along) + states[2, i] - bias
            out[2 * k + 1, i] = turned - _WHOLE_TURN * np.rint(turned / _WHOLE_TURN)


@kernel
def slopes(states, easts, norths, bias_row, scale_row, out):
    """Fill ``out`` (2 K, D, N), zeros, with the derivatives of the expectations of ranges and bearings by the states.

    Landmarks and rows as in ``innovations``. At a landmark the derivatives by x and y are zero.
    """
    for k in range(easts.size):
        for i in range(states.shape[1]):
            along, across = easts[k] - states[0, i], norths[k] - states[1, i]
            length = _hypot(along, across)
            distance = max(length, _NEAREST)
            cosine, sine = along / distance, across / distance
            scale = states[scale_row, i] if scale_row >= 0 else 1.0
            out[2 * k, 0, i], out[2 * k, 1, i] = -scale * cosine, -scale * sine
            out[2 * k + 1, 0, i], out[2 * k + 1, 1, i] = sine / distance, -cosine / distance
            out[2 * k + 1, 2, i] = -1.0
            if scale_row >= 0:
                out[2 * k, scale_row, i] = length
            if bias_row >= 0:
                out[2 * k + 1, bias_row, i] = 1.0
