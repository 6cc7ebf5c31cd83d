"""Likelihood of lines seen by a robot: each of many lines against each segment of the map at each of many poses."""

import numpy as np

from dynpf.kernels.compiler import kernel
from dynpf.kernels.elementary import exp, log, sincos, whole
from dynpf.kernels.philox import BLOCK

__all__ = ["log_likelihood"]

_f = np.float32
_ZERO, _HALF, _ONE, _TWO_PI, _INFINITY = _f(0.0), _f(0.5), _f(1.0), _f(2.0 * np.pi), _f(np.inf)
# The first part of pi has few bits, so that its product with a small integer is exact.
_PI_HIGH, _PI_LOW, _ONE_OVER_PI = _f(3.140625), _f(np.pi - 3.140625), _f(1.0 / np.pi)


@kernel
def log_likelihood(  # noqa: PLR0912 - a loop over particles for lines with a place, and one for those without
    out,
    x,
    y,
    theta,
    rhos,
    alphas,
    lengths,
    middles,
    offsets,
    normals,
    cosines,
    sines,
    longest,
    centres,
    sigma_rho,
    sigma_alpha,
    sigma_along,
    outlier_fraction,
    outlier_rho,
):
    """Fill ``out`` (N,) with the log-density of lines (K,) at poses x, y, theta, each (N,); all arrays are float32.

    A segment of the map lies on the line at the distance ``offsets`` from the origin in the direction ``normals``, with
    its cosine and sine, each (S,); it explains no line longer than ``longest``. Each line takes the segment that makes
    it likeliest. A line that is not finite counts as nothing; a pose that is not finite is impossible.

    With ``sigma_along`` above 0, a line's piece, whose middle lies ``middles`` (K,) to the left of where the line is
    nearest, has to lie within the segment, whose middle is at ``centres`` (S,) along its line; what it reaches beyond
    by more than the tolerance in ``longest`` counts as an error.
    """
    sigma_rho, sigma_alpha = _f(sigma_rho), _f(sigma_alpha)
    rho_scale, alpha_scale = _HALF / (sigma_rho * sigma_rho), _HALF / (sigma_alpha * sigma_alpha)
    peak = (_ONE - _f(outlier_fraction)) / (_TWO_PI * sigma_rho * sigma_alpha)
    log_peak = log(peak)
    floor = _f(outlier_fraction) / (_f(outlier_rho) * _TWO_PI)
    along_scale = _HALF / (_f(sigma_along) * _f(sigma_along)) if sigma_along > 0.0 else _ZERO
    best, total = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    middle_x, middle_y = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    for start in range(0, x.size, BLOCK):
        # Arrays of their own, so that the compiler knows that neighbours lie side by side.
        px, py, heading = x[start : start + BLOCK], y[start : start + BLOCK], theta[start : start + BLOCK]
        size = px.size
        total[:size] = _ZERO
        for k in range(rhos.size):
            rho = rhos[k]
            if not (abs(rho) < _INFINITY and abs(alphas[k]) < _INFINITY and abs(lengths[k]) < _INFINITY):
                continue
            best[:size] = _INFINITY
            if along_scale > _ZERO:
                sine, cosine = sincos(alphas[k])
                ahead, left = rho * cosine - middles[k] * sine, rho * sine + middles[k] * cosine
                for i in range(size):
                    sine, cosine = sincos(heading[i])
                    middle_x[i] = px[i] + (cosine * ahead - sine * left)
                    middle_y[i] = py[i] + (sine * ahead + cosine * left)
            for s in range(offsets.size):
                if lengths[k] > longest[s]:
                    continue
                turn, offset, cosine, sine = alphas[k] - normals[s], offsets[s], cosines[s], sines[s]
                if along_scale > _ZERO:
                    slack, centre = _HALF * (longest[s] - lengths[k]), centres[s]
                    for i in range(size):
                        expected = offset - (px[i] * cosine + py[i] * sine)
                        angle = turn + heading[i]
                        halves = np.rint(angle * _ONE_OVER_PI)
                        turned = (angle - halves * _PI_HIGH) - halves * _PI_LOW
                        away = rho + expected if (whole(halves) & 1) != 0 else rho - expected
                        beyond = max(abs(middle_y[i] * cosine - middle_x[i] * sine - centre) - slack, _ZERO)
                        error = rho_scale * away * away + alpha_scale * turned * turned + along_scale * beyond * beyond
                        best[i] = min(best[i], error)
                    continue
                for i in range(size):
                    expected = offset - (px[i] * cosine + py[i] * sine)
                    # (rho, alpha) and (-rho, alpha + pi) are one line: take the one that needs the smaller turn.
                    angle = turn + heading[i]
                    halves = np.rint(angle * _ONE_OVER_PI)
                    turned = (angle - halves * _PI_HIGH) - halves * _PI_LOW
                    away = rho + expected if (whole(halves) & 1) != 0 else rho - expected
                    best[i] = min(best[i], rho_scale * away * away + alpha_scale * turned * turned)
            if floor > _ZERO:
                for i in range(size):
                    total[i] += log(peak * exp(-best[i]) + floor)
            else:
                for i in range(size):
                    total[i] += log_peak - best[i]
        for i in range(size):
            out[start + i] = total[i] if abs(px[i]) + abs(py[i]) + abs(heading[i]) < _INFINITY else -_INFINITY
