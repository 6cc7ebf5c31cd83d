"""sin, cos, exp, log and atan2 in float32: polynomials without branches, so that loops over them become vectors.

Only additions, multiplications, square roots and roundings that IEEE 754 fixes: the same bits on every machine, which
a mathematical library does not promise. Coefficients: Cephes (Moshier), single precision. Errors against the exact
values, over the ranges stated: exp and log at most 1 unit in the last place, atan2 2.1, sine and cosine 1.6 * 2**-24
(2 units in the last place while |angle| < 10; near the zeros of larger angles the angle itself is no better known).
"""

import numpy as np

from dynpf.kernels.compiler import device

__all__ = ["atan2", "exp", "log", "sincos", "whole", "wrap"]

_f = np.float32

_LAST_BIT_ONE, _BITS_OF_ZERO = _f(1.5 * 2.0**23), np.int32(0x4B400000)  # the last bit of what is near is worth one
_TWO_OVER_PI = _f(0.63661977236758134)
# pi/2 in three parts; the first two have few bits, so that their product with a small integer is exact.
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = _f(1.5703125), _f(4.837512969970703125e-4), _f(7.5497894159e-8)
_S1, _S2, _S3 = _f(-1.6666654611e-1), _f(8.3321608736e-3), _f(-1.9515295891e-4)
_C1, _C2, _C3 = _f(4.166664568298827e-2), _f(-1.388731625493765e-3), _f(2.443315711809948e-5)
_ZERO, _HALF, _ONE, _TWO = _f(0.0), _f(0.5), _f(1.0), _f(2.0)

_LOG2_E = _f(1.44269504088896341)
_LN2_HIGH, _LN2_LOW = _f(0.693359375), _f(-2.12194440e-4)
_E0, _E1, _E2 = _f(1.9875691500e-4), _f(1.3981999507e-3), _f(8.3334519073e-3)
_E3, _E4, _E5 = _f(4.1665795894e-2), _f(1.6666665459e-1), _f(5.0000001201e-1)
_EXP_LOWEST, _EXP_HIGHEST = _f(-87.0), _f(88.0)

_L0, _L1, _L2 = _f(7.0376836292e-2), _f(-1.1514610310e-1), _f(1.1676998740e-1)
_L3, _L4, _L5 = _f(-1.2420140846e-1), _f(1.4249322787e-1), _f(-1.6668057665e-1)
_L6, _L7, _L8 = _f(2.0000714765e-1), _f(-2.4999993993e-1), _f(3.3333331174e-1)
_SQRT_HALF = _f(0.70710678118654752)
_MANTISSA, _HALF_BITS, _EXPONENT_BIAS = np.int32(0x007FFFFF), np.int32(0x3F000000), np.int32(126)
_SMALLEST = _f(1.17549435e-38)

_A0, _A1, _A2, _A3 = _f(8.05374449538e-2), _f(-1.38776856032e-1), _f(1.99777106478e-1), _f(-3.33329491539e-1)
_PI, _HALF_PI, _QUARTER_PI = _f(np.pi), _f(np.pi / 2), _f(np.pi / 4)
_QUARTER_PI_LOW = _f(np.pi / 4 - np.float64(_QUARTER_PI))
_TAN_PI_8 = _f(0.4142135623730950)
_TWO_PI_HIGH, _TWO_PI_LOW, _ONE_OVER_TWO_PI = _f(6.28125), _f(2.0 * np.pi - 6.28125), _f(0.5 / np.pi)


@device
def whole(number):
    """Return a whole number, |number| < 2**22, as int32; beyond, and of NaN, any.

    It stands at the end of the sum's bits. A cast would do, but each processor casts what does not fit in its own way.
    """
    return np.int32(_f(number + _LAST_BIT_ONE).view(np.int32) - _BITS_OF_ZERO)


@device
def sincos(angle):
    """Return sine and cosine of an angle in radians, |angle| < 8000: beyond, any numbers; NaN of infinity and NaN."""
    turns = np.rint(angle * _TWO_OVER_PI)
    rest = ((angle - turns * _HALF_PI_1) - turns * _HALF_PI_2) - turns * _HALF_PI_3
    quadrant = whole(turns)
    square = rest * rest
    sine = rest + rest * square * (_S1 + square * (_S2 + square * _S3))
    cosine = (_ONE - _HALF * square) + square * square * (_C1 + square * (_C2 + square * _C3))
    swapped = (quadrant & 1) != 0
    first = cosine if swapped else sine
    second = sine if swapped else cosine
    first = -first if (quadrant & 2) != 0 else first
    second = -second if ((quadrant + 1) & 2) != 0 else second
    return first, second


@device
def exp(value):
    """Return e to the power of ``value``; zero below -87, e^88 above 88, NaN of NaN."""
    clipped = min(max(value, _EXP_LOWEST), _EXP_HIGHEST)
    twos = np.rint(clipped * _LOG2_E)
    rest = (clipped - twos * _LN2_HIGH) - twos * _LN2_LOW
    series = ((((_E0 * rest + _E1) * rest + _E2) * rest + _E3) * rest + _E4) * rest + _E5
    scale = np.int32((whole(twos) + np.int32(127)) << 23).view(np.float32)
    result = (series * rest * rest + rest + _ONE) * scale
    return _ZERO if value < _EXP_LOWEST else result


@device
def log(value):
    """Return the natural logarithm of a positive normal number; of anything smaller, that of the smallest such, -87.3.

    So of NaN too, which a likelihood then takes for as good as impossible; of infinity 88.7.
    """
    # Of two numbers one of which is NaN, max and min return the first.
    bits = _f(max(_SMALLEST, value)).view(np.int32)
    exponent = _f(np.int32((bits >> 23) - _EXPONENT_BIAS))
    mantissa = np.int32((bits & _MANTISSA) | _HALF_BITS).view(np.float32)
    small = mantissa < _SQRT_HALF
    exponent = exponent - _ONE if small else exponent
    rest = (mantissa + mantissa if small else mantissa) - _ONE
    square = rest * rest
    series = ((((((_L0 * rest + _L1) * rest + _L2) * rest + _L3) * rest + _L4) * rest + _L5) * rest + _L6) * rest + _L7
    series = (series * rest + _L8) * rest * square
    series = series + exponent * _LN2_LOW - _HALF * square
    return rest + series + exponent * _LN2_HIGH


@device
def atan2(y, x):
    """Return the direction of (x, y) in (-pi, pi]; zero at the origin.

    A zero has no sign here, so that the direction of (-1, -0) is pi. NaN where either is NaN or both are infinite;
    above 1.7e38, half the largest number, two coordinates overflow.
    """
    across, along = abs(y), abs(x)
    # Of two numbers one of which is NaN, max and min return the first: so NaN of y reaches the one, of x the other.
    larger, smaller = max(across, along), min(along, across)
    steep = smaller > _TAN_PI_8 * larger
    opposite = smaller - larger if steep else smaller
    adjacent = smaller + larger if steep else larger
    rest = opposite / (_ONE if larger == _ZERO else adjacent)
    square = rest * rest
    series = (((_A0 * square + _A1) * square + _A2) * square + _A3) * square * rest
    angle = _QUARTER_PI + (rest + (series + _QUARTER_PI_LOW)) if steep else rest + series
    angle = _HALF_PI - angle if across > along else angle
    angle = _PI - angle if x < _ZERO else angle
    return -angle if y < _ZERO else angle


@device
def wrap(angle):
    """Return an angle within [-pi, pi], |angle| < 8000; unchanged if it was there.

    Rounding decides between -pi and pi, and may leave 1e-7 |angle| more than pi. The error is at most 3.2 * 2**-24.
    """
    turns = np.rint(angle * _ONE_OVER_TWO_PI)
    return (angle - turns * _TWO_PI_HIGH) - turns * _TWO_PI_LOW
