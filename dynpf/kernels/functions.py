"""The elementary functions of ``elementary64`` as Python calls them: of one number, and of arrays in one dimension."""

import numpy as np

from dynpf.kernels import elementary64
from dynpf.kernels.compiler import kernel

__all__ = [
    "atan2_all",
    "atan2_one",
    "cos_all",
    "cos_one",
    "erf_all",
    "erf_one",
    "exp_all",
    "exp_one",
    "expm1_all",
    "expm1_one",
    "hypot_all",
    "hypot_one",
    "log1p_all",
    "log1p_one",
    "log_all",
    "log_one",
    "normals",
    "sin_all",
    "sin_one",
    "sinc_all",
    "sincos_all",
    "sincos_one",
    "tan_all",
    "tan_one",
]

_sincos, _tan, _exp, _log = elementary64.sincos, elementary64.tan, elementary64.exp, elementary64.log
_log1p, _atan2, _hypot, _erf = elementary64.log1p, elementary64.atan2, elementary64.hypot, elementary64.erf
_expm1 = elementary64.expm1
_TWO_PI = 2.0 * np.pi


@kernel
def sin_one(value):
    """Return the sine of one number."""
    return _sincos(value)[0]


@kernel
def cos_one(value):
    """Return the cosine of one number."""
    return _sincos(value)[1]


@kernel
def sincos_one(value):
    """Return sine and cosine of one number."""
    return _sincos(value)


@kernel
def tan_one(value):
    """Return the tangent of one number."""
    return _tan(value)


@kernel
def exp_one(value):
    """Return the exponential of one number."""
    return _exp(value)


@kernel
def log_one(value):
    """Return the logarithm of one number."""
    return _log(value)


@kernel
def log1p_one(value):
    """Return log(1 + value) of one number."""
    return _log1p(value)


@kernel
def expm1_one(value):
    """Return e^value - 1 of one number."""
    return _expm1(value)


@kernel
def atan2_one(y, x):
    """Return the direction of one point."""
    return _atan2(y, x)


@kernel
def erf_one(value):
    """Return the error function of one number."""
    return _erf(value)


@kernel
def hypot_one(x, y):
    """Return the length of one vector."""
    return _hypot(x, y)


@kernel
def sin_all(values, out):
    """Fill ``out`` (N,) with the sines of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _sincos(values[i])[0]


@kernel
def sinc_all(values, out):
    """Fill ``out`` (N,) with sin(pi x) / (pi x), 1 at zero, of ``values`` (N,)."""
    for i in range(values.size):
        angle = np.pi * values[i]
        out[i] = _sincos(angle)[0] / angle if angle != 0.0 else 1.0


@kernel
def cos_all(values, out):
    """Fill ``out`` (N,) with the cosines of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _sincos(values[i])[1]


@kernel
def sincos_all(values, sines, cosines):
    """Fill ``sines`` and ``cosines`` (N,) of ``values`` (N,)."""
    for i in range(values.size):
        sines[i], cosines[i] = _sincos(values[i])


@kernel
def tan_all(values, out):
    """Fill ``out`` (N,) with the tangents of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _tan(values[i])


@kernel
def exp_all(values, out):
    """Fill ``out`` (N,) with the exponentials of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _exp(values[i])


@kernel
def log_all(values, out):
    """Fill ``out`` (N,) with the logarithms of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _log(values[i])


@kernel
def log1p_all(values, out):
    """Fill ``out`` (N,) with log(1 + value) of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _log1p(values[i])


@kernel
def expm1_all(values, out):
    """Fill ``out`` (N,) with e^value - 1 of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _expm1(values[i])


@kernel
def atan2_all(y, x, out):
    """Fill ``out`` (N,) with the directions of the points (x, y), each (N,)."""
    for i in range(y.size):
        out[i] = _atan2(y[i], x[i])


@kernel
def erf_all(values, out):
    """Fill ``out`` (N,) with the error function of ``values`` (N,)."""
    for i in range(values.size):
        out[i] = _erf(values[i])


@kernel
def hypot_all(x, y, out):
    """Fill ``out`` (N,) with the lengths of the vectors (x, y), each (N,)."""
    for i in range(x.size):
        out[i] = _hypot(x[i], y[i])


@kernel
def normals(chances, turns, out):
    """Fill ``out`` (2 N,) with standard normal numbers by Box and Muller's method from two uniform ones a pair, (N,).

    ``chances`` are in (0, 1], ``turns`` in [0, 1). The first N are the cosines', the others the sines'.
    """
    half = chances.size
    for i in range(half):
        radius = np.sqrt(-2.0 * _log(chances[i]))
        sine, cosine = _sincos(_TWO_PI * turns[i])
        out[i] = radius * cosine
        out[half + i] = radius * sine
