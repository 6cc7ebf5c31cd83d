"""Elementary functions in float64: the same bits on every machine, which a mathematical library does not promise.

Only additions, multiplications, divisions, square roots and roundings that IEEE 754 fixes, in a fixed order. The
coefficients are those of fdlibm (Sun Microsystems, 1993). Errors in units in the last place, over the ranges stated:
exp and log 0.9, sine and cosine 0.8, atan2 1.5, tangent 2.2, hypot 1.2, log1p 1.5,
expm1 3, erf 20.
"""

import numpy as np

from dynpf.kernels.compiler import device

__all__ = ["atan2", "erf", "exp", "expm1", "hypot", "log", "log1p", "sincos", "tan"]

_f, _i = np.float64, np.int64

_LAST_BIT_ONE, _BITS_OF_ZERO = 1.5 * 2.0**52, _i(0x4338000000000000)  # the last bit of what is near is worth one
_TWO_OVER_PI = 6.36619772367581382433e-01
# pi/2 in three parts; the first two have 33 bits, so that their product with a whole number below 2**20 is exact.
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_TWO_PI, _FAR = 2.0 * np.pi, 1.6e6
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11

_LOG2_E, _LN2_HIGH, _LN2_LOW = 1.44269504088896338700, 6.93147180369123816490e-01, 1.90821492927058770002e-10
_E1, _E2, _E3 = 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05
_E4, _E5 = -1.65339022054652515390e-06, 4.13813679705723846039e-08
_EXP_LOWEST, _EXP_HIGHEST = -745.2, 709.782712893384

_L1, _L2, _L3, _L4 = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
)
_L5, _L6, _L7 = 1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01
_SQRT_2, _SMALLEST, _TWO_54 = 1.4142135623730951, 2.2250738585072014e-308, 18014398509481984.0
_MANTISSA, _ONE_BITS = _i(0x000FFFFFFFFFFFFF), _i(0x3FF0000000000000)

_A0, _A1, _A2 = 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01
_A3, _A4, _A5 = -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02
_A6, _A7, _A8 = 6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02
_A9, _A10 = -3.65315727442169155270e-02, 1.62858201153657823623e-02
# atan of 1/2, 1, 3/2 and infinity, each in two parts.
_ATAN_HALF, _ATAN_HALF_LOW = 4.63647609000806093515e-01, 2.26987774529616870924e-17
_ATAN_ONE, _ATAN_ONE_LOW = 7.85398163397448278999e-01, 3.06161699786838301793e-17
_ATAN_MORE, _ATAN_MORE_LOW = 9.82793723247329054082e-01, 1.39033110312309984516e-17
_ZERO = 0.0
_HALF_PI, _HALF_PI_LOW = 1.57079632679489655800e00, 6.12323399573676603587e-17
_PI, _PI_LOW = 3.14159265358979311600e00, 1.22464679914735317720e-16

_TWO_OVER_ROOT_PI = 1.12837916709551257390
_HUGE, _TINY, _UP, _DOWN = 2.0**500, 2.0**-500, 2.0**600, 2.0**-600


@device
def _whole(number):
    """Return a whole number, |number| < 2**51, as int64; beyond, and of NaN, any.

    It stands at the end of the sum's bits. A cast would do, but each processor casts what does not fit in its own way.
    """
    return _f(number + _LAST_BIT_ONE).view(np.int64) - _BITS_OF_ZERO


@device
def sincos(angle):
    """Return sine and cosine of an angle in radians; NaN of infinity and NaN.

    Beyond 1.6e6 the angle is first taken modulo the float64 nearest to 2 pi, which loses accuracy, but no bits.
    """
    near = angle if abs(angle) < _FAR else np.fmod(angle, _TWO_PI)
    turns = np.rint(near * _TWO_OVER_PI)
    first = near - turns * _HALF_PI_1
    carried = turns * _HALF_PI_2
    second = first - carried
    carried = turns * _HALF_PI_3 - ((first - second) - carried)
    rest = second - carried
    low = (second - rest) - carried
    square = rest * rest
    cube = square * rest
    series = _S2 + square * (_S3 + square * (_S4 + square * (_S5 + square * _S6)))
    sine = rest - ((square * (0.5 * low - cube * series) - low) - cube * _S1)
    series = square * (_C1 + square * (_C2 + square * (_C3 + square * (_C4 + square * (_C5 + square * _C6)))))
    half = 0.5 * square
    most = 1.0 - half
    cosine = most + (((1.0 - most) - half) + (square * series - rest * low))
    quadrant = _whole(turns) & 3
    swapped = (quadrant & 1) != 0
    across = cosine if swapped else sine
    along = sine if swapped else cosine
    across = -across if (quadrant & 2) != 0 else across
    along = -along if ((quadrant + 1) & 2) != 0 else along
    return across, along


@device
def tan(angle):
    """Return the tangent of an angle in radians; NaN of infinity and NaN."""
    sine, cosine = sincos(angle)
    return sine / cosine


@device
def exp(value):
    """Return e to the power of ``value``: 0 below -745.2, infinity above 709.78, NaN of NaN."""
    clipped = min(max(value, _EXP_LOWEST), _EXP_HIGHEST)
    twos = np.rint(clipped * _LOG2_E)
    high, low = clipped - twos * _LN2_HIGH, twos * _LN2_LOW
    rest = high - low
    square = rest * rest
    series = rest - square * (_E1 + square * (_E2 + square * (_E3 + square * (_E4 + square * _E5))))
    result = 1.0 - ((low - (rest * series) / (2.0 - series)) - high)
    # In two steps: one factor alone would be beyond the smallest or the largest normal number.
    whole = _whole(twos)
    part = whole >> 1
    result = result * _two_to(part) * _two_to(whole - part)
    result = np.inf if value > _EXP_HIGHEST else result
    result = 0.0 if value < _EXP_LOWEST else result
    return value if np.isnan(value) else result


@device
def _two_to(power):
    """Return 2 to a whole power within -1022 and 1023."""
    return _i((power + 1023) << 52).view(np.float64)


@device
def log(value):
    """Return the natural logarithm: -infinity of zero, NaN below and of NaN, infinity of infinity."""
    subnormal = value < _SMALLEST
    bits = np.float64(value * _TWO_54 if subnormal else value).view(np.int64)
    mantissa = _i((bits & _MANTISSA) | _ONE_BITS).view(np.float64)
    exponent = _f((bits >> 52) - 1023 - (54 if subnormal else 0))
    large = mantissa > _SQRT_2
    mantissa = 0.5 * mantissa if large else mantissa
    exponent = exponent + 1.0 if large else exponent
    rest = mantissa - 1.0
    ratio = rest / (2.0 + rest)
    square = ratio * ratio
    series = square * (
        _L1 + square * (_L2 + square * (_L3 + square * (_L4 + square * (_L5 + square * (_L6 + square * _L7)))))
    )
    half = 0.5 * rest * rest
    finite = exponent * _LN2_HIGH - ((half - (ratio * (half + series) + exponent * _LN2_LOW)) - rest)
    result = value if value == np.inf else finite
    return (result if value > 0.0 else -np.inf) if value >= 0.0 else np.nan


@device
def log1p(value):
    """Return log(1 + value), accurate for small values, too."""
    whole = 1.0 + value
    # What the sum has lost, to first order.
    lost = (value - (whole - 1.0)) / whole
    return log(whole) + lost if abs(value) < 1.0 else log(whole)


@device
def expm1(value):
    """Return e^value - 1, accurate for small values, too (Kahan): what rounding did to e^value its logarithm knows."""
    power = exp(value)
    less = power - 1.0
    near = abs(value) < 1.0 and less != 0.0
    result = less * (value / (log(power) if near else 1.0)) if near else less
    return value if less == 0.0 else result


@device
def atan2(y, x):
    """Return the direction of (x, y) in [-pi, pi]; that of (-1, -0) is -pi, and of the origin as IEEE 754 has it."""
    across, along = abs(y), abs(x)
    both = across == np.inf and along == np.inf
    ratio = 1.0 if both else across / along
    ratio = 0.0 if across == 0.0 and along == 0.0 else ratio
    angle = _atan(ratio)
    angle = _PI - (angle - _PI_LOW) if np.copysign(1.0, x) < 0.0 else angle
    return angle if np.isnan(angle) else np.copysign(angle, y)


@device
def _atan(value):
    """Return the arc tangent of a number that is not negative."""
    base, low, reduced = _ZERO, _ZERO, value
    if value >= 2.4375:
        base, low, reduced = _HALF_PI, _HALF_PI_LOW, -1.0 / value
    elif value >= 1.1875:
        base, low, reduced = _ATAN_MORE, _ATAN_MORE_LOW, (value - 1.5) / (1.0 + 1.5 * value)
    elif value >= 0.6875:
        base, low, reduced = _ATAN_ONE, _ATAN_ONE_LOW, (value - 1.0) / (value + 1.0)
    elif value >= 0.4375:
        base, low, reduced = _ATAN_HALF, _ATAN_HALF_LOW, (2.0 * value - 1.0) / (2.0 + value)
    square = reduced * reduced
    fourth = square * square
    odd = square * (_A0 + fourth * (_A2 + fourth * (_A4 + fourth * (_A6 + fourth * (_A8 + fourth * _A10)))))
    even = fourth * (_A1 + fourth * (_A3 + fourth * (_A5 + fourth * (_A7 + fourth * _A9))))
    return base - ((reduced * (odd + even) - low) - reduced)


@device
def erf(value):
    """Return the error function: the series of Abramowitz and Stegun (7.1.6), whose terms are all positive."""
    size = min(abs(value), 6.0)
    square = 2.0 * size * size
    term, total, odd = 1.0, 1.0, 1.0
    while term > 2.0**-56 * total:
        odd += 2.0
        term *= square / odd
        total += term
    result = _TWO_OVER_ROOT_PI * size * exp(-size * size) * total
    return value if np.isnan(value) else np.copysign(min(result, 1.0), value)


@device
def hypot(x, y):
    """Return sqrt(x^2 + y^2), also where the squares would overflow; infinity if either is infinite, else NaN of NaN.

    Squares below 1e-300 are scaled, so that small lengths keep their digits.
    """
    across, along = abs(x), abs(y)
    larger = max(across, along)
    scale = _DOWN if larger > _HUGE else (_UP if larger < _TINY else 1.0)
    back = _UP if larger > _HUGE else (_DOWN if larger < _TINY else 1.0)
    across, along = across * scale, along * scale
    length = np.sqrt(across * across + along * along) * back
    return np.inf if abs(x) == np.inf or abs(y) == np.inf else length
