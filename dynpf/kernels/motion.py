"""Particles moved: one pass over rows of float32, with noise that was drawn before.

Every kernel reads rows of the particles and of standard normal numbers ``noise`` (3, N), and writes the rows x, y and
theta, given last. Headings leave within [-pi, pi]: float32 would lose digits to every turn that they kept.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import sincos, wrap

__all__ = ["follow_arcs", "follow_own_arcs", "follow_twist", "move_capsule", "rotate_translate_rotate"]

_f = np.float32
_HALF, _ONE, _SMALL, _SIXTH = _f(0.5), _f(1.0), _f(1e-3), _f(1.0 / 6.0)


@device
def chord(theta, length, turn):
    """Return length and direction, as sine and cosine, of the chord of an arc that starts with heading ``theta``."""
    half = _HALF * turn
    sine, _ = sincos(half)
    tiny = abs(half) < _SMALL
    ratio = sine / (_ONE if tiny else half)
    ratio = _ONE - half * half * _SIXTH if tiny else ratio
    across, along = sincos(theta + half)
    return length * ratio, across, along


@kernel
def follow_arcs(x, y, theta, noise, length, turn, sigma_along, sigma_turn, sigma_across, new_x, new_y, new_theta):
    """Move along arcs of ``length`` and ``turn``, slipping at right angles to the chord; noise (3, N)."""
    length, turn = _f(length), _f(turn)
    sigma_along, sigma_turn, sigma_across = _f(sigma_along), _f(sigma_turn), _f(sigma_across)
    for i in range(x.size):
        turned = turn + sigma_turn * noise[1, i]
        slip = sigma_across * noise[2, i]
        way, sine, cosine = chord(theta[i], length + sigma_along * noise[0, i], turned)
        new_x[i] = x[i] + (way * cosine - slip * sine)
        new_y[i] = y[i] + (way * sine + slip * cosine)
        new_theta[i] = wrap(theta[i] + turned)


@kernel
def follow_own_arcs(x, y, theta, lengths, turns, noise, sigma_along, sigma_turn, sigma_across, new_x, new_y, new_theta):
    """Move as ``follow_arcs`` does, each particle along an arc of its own, ``lengths`` and ``turns`` (N,)."""
    sigma_along, sigma_turn, sigma_across = _f(sigma_along), _f(sigma_turn), _f(sigma_across)
    for i in range(x.size):
        turned = turns[i] + sigma_turn * noise[1, i]
        slip = sigma_across * noise[2, i]
        way, sine, cosine = chord(theta[i], lengths[i] + sigma_along * noise[0, i], turned)
        new_x[i] = x[i] + (way * cosine - slip * sine)
        new_y[i] = y[i] + (way * sine + slip * cosine)
        new_theta[i] = wrap(theta[i] + turned)


@kernel
def follow_twist(x, y, theta, noise, length, turn, sigma_length, sigma_turn, sigma_final, new_x, new_y, new_theta):
    """Move along arcs of ``length`` and ``turn``, then turn a little more on the spot; noise (3, N)."""
    length, turn = _f(length), _f(turn)
    sigma_length, sigma_turn, sigma_final = _f(sigma_length), _f(sigma_turn), _f(sigma_final)
    for i in range(x.size):
        turned = turn + sigma_turn * noise[1, i]
        way, sine, cosine = chord(theta[i], length + sigma_length * noise[0, i], turned)
        new_x[i] = x[i] + way * cosine
        new_y[i] = y[i] + way * sine
        new_theta[i] = wrap(theta[i] + (turned + sigma_final * noise[2, i]))


@kernel
def rotate_translate_rotate(
    x, y, theta, noise, first, way, second, sigma_first, sigma_way, sigma_second, new_x, new_y, new_theta
):
    """Rotate by ``first``, go ``way`` straight on, rotate by ``second``; noise (3, N) in that order."""
    first, way, second = _f(first), _f(way), _f(second)
    sigma_first, sigma_way, sigma_second = _f(sigma_first), _f(sigma_way), _f(sigma_second)
    for i in range(x.size):
        rotated = first + sigma_first * noise[0, i]
        gone = way + sigma_way * noise[1, i]
        sine, cosine = sincos(theta[i] + rotated)
        new_x[i] = x[i] + gone * cosine
        new_y[i] = y[i] + gone * sine
        new_theta[i] = wrap(theta[i] + (rotated + (second + sigma_second * noise[2, i])))


@kernel
def move_capsule(x, y, theta, noise, rho, turn, sigma, sigma_theta, new_x, new_y, new_theta):
    """Turn, then go ``rho`` along the new heading, noise (3, N) on all three coordinates."""
    rho, turn, sigma, sigma_theta = _f(rho), _f(turn), _f(sigma), _f(sigma_theta)
    for i in range(x.size):
        turned = theta[i] + turn
        sine, cosine = sincos(turned)
        new_x[i] = x[i] + (rho * cosine + sigma * noise[0, i])
        new_y[i] = y[i] + (rho * sine + sigma * noise[1, i])
        new_theta[i] = wrap(turned + sigma_theta * noise[2, i])
