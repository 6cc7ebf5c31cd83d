"""Likelihood of lines seen by a robot: each of many lines against each segment of the map at each of many poses."""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import exp, log, sincos, whole
from dynpf.kernels.philox import BLOCK

__all__ = ["log_likelihood"]

_f = np.float32
_ZERO, _HALF, _ONE, _TWO_PI, _INFINITY = _f(0.0), _f(0.5), _f(1.0), _f(2.0 * np.pi), _f(np.inf)
# The first part of pi has few bits, so that its product with a small integer is exact.
_PI_HIGH, _PI_LOW, _ONE_OVER_PI = _f(3.140625), _f(np.pi - 3.140625), _f(1.0 / np.pi)


@device
def _differences(rho, expected, angle):
    """Return the errors of a line at the distance ``rho``: of the distance, and of its direction, off by ``angle``.

    (rho, alpha) and (-rho, alpha + pi) are one line: of the two, the one that needs the smaller turn.
    """
    halves = np.rint(angle * _ONE_OVER_PI)
    turned = (angle - halves * _PI_HIGH) - halves * _PI_LOW
    return rho + expected if (whole(halves) & 1) != 0 else rho - expected, turned


@device
def _find_middles(x, y, theta, rho, alpha, middle, middle_x, middle_y):
    """Write where the middle of a line's piece lies in the map, (N,), seen from each pose."""
    sine, cosine = sincos(alpha)
    ahead, left = rho * cosine - middle * sine, rho * sine + middle * cosine
    for i in range(x.size):
        sine, cosine = sincos(theta[i])
        middle_x[i] = x[i] + (cosine * ahead - sine * left)
        middle_y[i] = y[i] + (sine * ahead + cosine * left)


@device
def _add_log(total, best, peak, floor):
    """Add to ``total`` the logarithm of peak exp(-best) + floor, which without a floor cannot underflow."""
    if floor > _ZERO:
        for i in range(total.size):
            total[i] += log(peak * exp(-best[i]) + floor)
    else:
        log_peak = log(peak)
        for i in range(total.size):
            total[i] += log_peak - best[i]


@kernel
def log_likelihood(x, y, theta, lines, segments, noise, out):
    """Fill ``out`` (N,) with the log-density of lines (K,) at poses x, y, theta, each (N,); all arrays are float32.

    ``lines``, ``segments``, ``noise``: Lines, with middles in any case, Segments and LineNoise of
    ``dynpf.measurement.lines``. Each line takes the segment that makes it likeliest. A line that is not finite counts
    as nothing; a pose that is not finite is impossible.

    With ``sigma_along`` above 0, a line's piece has to lie within the segment; what it reaches beyond by more than the
    tolerance in ``longest`` counts as an error.
    """
    rhos, alphas, lengths, middles = lines.rho, lines.alpha, lines.lengths, lines.middles
    offsets, normals, cosines, sines = segments.offsets, segments.normals, segments.cosines, segments.sines
    longest, centres = segments.longest, segments.centres
    sigma_rho, sigma_alpha, sigma_along = _f(noise.sigma_rho), _f(noise.sigma_alpha), _f(noise.sigma_along)
    rho_scale, alpha_scale = _HALF / (sigma_rho * sigma_rho), _HALF / (sigma_alpha * sigma_alpha)
    along_scale = _HALF / (sigma_along * sigma_along) if sigma_along > _ZERO else _ZERO
    peak = (_ONE - _f(noise.outlier_fraction)) / (_TWO_PI * sigma_rho * sigma_alpha)
    floor = _f(noise.outlier_fraction) / (_f(noise.outlier_rho) * _TWO_PI)
    best, total = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    middle_x, middle_y = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    for start in range(0, x.size, BLOCK):
        # Arrays of their own, so that the compiler knows that neighbours lie side by side.
        px, py, heading = x[start : start + BLOCK], y[start : start + BLOCK], theta[start : start + BLOCK]
        size = px.size
        total[:size] = _ZERO
        for k in range(rhos.size):
            rho, alpha, length = rhos[k], alphas[k], lengths[k]
            if not (abs(rho) < _INFINITY and abs(alpha) < _INFINITY and abs(length) < _INFINITY):
                continue
            best[:size] = _INFINITY
            if along_scale > _ZERO:
                _find_middles(px, py, heading, rho, alpha, middles[k], middle_x, middle_y)
            for s in range(offsets.size):
                if length > longest[s]:
                    continue
                turn, offset, cosine, sine = alpha - normals[s], offsets[s], cosines[s], sines[s]
                if along_scale > _ZERO:
                    slack, centre = _HALF * (longest[s] - length), centres[s]
                    for i in range(size):
                        expected = offset - (px[i] * cosine + py[i] * sine)
                        away, turned = _differences(rho, expected, turn + heading[i])
                        beyond = max(abs(middle_y[i] * cosine - middle_x[i] * sine - centre) - slack, _ZERO)
                        error = rho_scale * away * away + alpha_scale * turned * turned + along_scale * beyond * beyond
                        best[i] = min(best[i], error)
                else:
                    for i in range(size):
                        expected = offset - (px[i] * cosine + py[i] * sine)
                        away, turned = _differences(rho, expected, turn + heading[i])
                        best[i] = min(best[i], rho_scale * away * away + alpha_scale * turned * turned)
            _add_log(total[:size], best, peak, floor)
        for i in range(size):
            out[start + i] = total[i] if abs(px[i]) + abs(py[i]) + abs(heading[i]) < _INFINITY else -_INFINITY
