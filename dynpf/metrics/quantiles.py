"""Quantiles of the distributions that statistical statements need, to about 1e-12."""

import math
from collections.abc import Callable

import numpy as np

from dynpf.portable import normal_quantile

__all__ = ["chi_square_quantile", "normal_quantile", "student_t_quantile"]

_EPSILON = 2.0**-53
_TINY = 1e-300


def chi_square_quantile(probability: float, degrees: float) -> float:
    """Return what a chi-square variable with ``degrees`` > 0 of freedom stays below with ``probability`` in (0, 1).

    The regularized incomplete gamma function P(a, x), a = degrees / 2, x = quantile / 2, is inverted by Newton's
    method over log x, on the tail that is the smaller. Raises ValueError for an argument out of range.
    """
    _check(probability)
    if not (0.0 < degrees < math.inf):
        raise ValueError(f"degrees = {degrees}: expected a positive number")
    a = 0.5 * degrees
    lower = probability < 0.5
    target = probability if lower else 1.0 - probability

    def excess(log_x: float) -> tuple[float, float]:
        x = math.exp(log_x)
        density = _gamma_density(a, x)
        tail = _gamma_tail(a, x, density, lower=lower)
        return (tail - target, density) if lower else (target - tail, density)

    low = high = math.log(a)
    step = 1.0
    while excess(low)[0] > 0.0:
        low, step = low - step, 2.0 * step
    step = 1.0
    while excess(high)[0] < 0.0:
        high, step = high + step, 2.0 * step
    return 2.0 * math.exp(_increasing_root(excess, low, high))


def student_t_quantile(probability: float, degrees: int) -> float:
    """Return what Student's t with ``degrees`` >= 1 of freedom stays below with ``probability`` in (0, 1).

    With t = sqrt(degrees) tan(angle) the distribution is a finite sum of powers of cos(angle) (Abramowitz and Stegun,
    26.7.3 and 26.7.4), which Newton's method inverts. Raises ValueError for an argument out of range.
    """
    _check(probability)
    if degrees < 1:
        raise ValueError(f"degrees = {degrees}: expected a whole number of at least 1")
    target = abs(2.0 * probability - 1.0)
    log_scale = math.lgamma(0.5 * (degrees + 1)) - math.lgamma(0.5 * degrees) - 0.5 * math.log(math.pi)

    def excess(angle: float) -> tuple[float, float]:
        density = 2.0 * math.exp(log_scale) * math.cos(angle) ** (degrees - 1)
        return _central_probability(angle, degrees) - target, density

    angle = _increasing_root(excess, 0.0, 0.5 * math.pi)
    return math.copysign(math.sqrt(degrees) * math.tan(angle), probability - 0.5)


def _check(probability: float) -> None:
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability = {probability}: expected a number between 0 and 1, both excluded")


def _gamma_density(a: float, x: float) -> float:
    """Return x^a e^-x / Gamma(a), the derivative of P(a, x) with respect to log x."""
    if a < 20.0:
        return math.exp(a * math.log(x) - x - math.lgamma(a))
    # Stirling's series; powers of x and a would lose digits to one another in the logarithm above.
    correction = 1.0 / (12.0 * a) - 1.0 / (360.0 * a**3) + 1.0 / (1260.0 * a**5) - 1.0 / (1680.0 * a**7)
    offset = (x - a) / a
    return math.sqrt(a / (2.0 * math.pi)) * math.exp(-a * (offset - math.log1p(offset)) - correction)


def _gamma_tail(a: float, x: float, density: float, *, lower: bool) -> float:
    """Return P(a, x), or 1 - P(a, x) for the upper tail."""
    if x < a + 1.0:
        inner = density * _series(a, x)
        return inner if lower else 1.0 - inner
    outer = density * _continued_fraction(a, x)
    return 1.0 - outer if lower else outer


def _series(a: float, x: float) -> float:
    """Return sum of x^n / (a (a + 1) ... (a + n)) over n >= 0."""
    term = total = 1.0 / a
    divisor = a
    while term > _EPSILON * total:
        divisor += 1.0
        term *= x / divisor
        total += term
    return total


def _continued_fraction(a: float, x: float) -> float:
    """Return 1 / (x + 1 - a - 1 (1 - a) / (x + 3 - a - 2 (2 - a) / ...)) by Lentz's method."""
    denominator = x + 1.0 - a
    c, d = 1.0 / _TINY, 1.0 / denominator
    value, factor, n = d, 0.0, 0
    while abs(factor - 1.0) > 2.0 * _EPSILON:
        n += 1
        numerator = -n * (n - a)
        denominator += 2.0
        d = 1.0 / (numerator * d + denominator or _TINY)
        c = denominator + numerator / c or _TINY
        factor = c * d
        value *= factor
    return value


def _central_probability(angle: float, degrees: int) -> float:
    """Return the probability that t is between -+sqrt(degrees) tan(angle)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    odd = degrees % 2
    first = np.arange(1 + odd, degrees - 1, 2)
    terms = np.cumprod(first / (first + 1.0) * cosine**2)
    if not odd:
        return sine * (1.0 + float(terms.sum()))
    inner = sine * cosine * (1.0 + float(terms.sum())) if degrees > 1 else 0.0
    return 2.0 / math.pi * (angle + inner)


def _increasing_root(excess: Callable[[float], tuple[float, float]], low: float, high: float) -> float:
    """Return where a function that rises from low to high is zero; it returns its value and its slope.

    Newton's method, kept within the bracket by halving it instead where a step would leave it.
    """
    x = 0.5 * (low + high)
    for _ in range(200):
        value, slope = excess(x)
        if value < 0.0:
            low = x
        else:
            high = x
        following = x - value / slope if slope > 0.0 else math.inf
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - x) <= 4.0 * _EPSILON * max(abs(x), _EPSILON):
            return following
        x = following
    return x
