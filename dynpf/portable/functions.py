"""Elementary functions: of a float a float, of an array an array of float64 of the same shape; arguments broadcast.

The errors in units in the last place stand in ``dynpf.kernels.elementary64``.
"""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.types import FloatArray

__all__ = [
    "as_values",
    "atan2",
    "cos",
    "dist",
    "erf",
    "exp",
    "expm1",
    "hypot",
    "log",
    "log1p",
    "logaddexp",
    "normal_quantile",
    "power",
    "sin",
    "sinc",
    "sincos",
    "tan",
    "whole",
]

Whole = TypeVar("Whole", bound=np.integer[Any])


@overload
def sin(angle: float) -> float: ...
@overload
def sin(angle: NDArray[Any]) -> FloatArray: ...
def sin(angle: Any) -> Any:
    """Return the sine of angles in radians."""
    functions = kernels.functions
    return functions.sin_one(angle) if isinstance(angle, float) else _mapped(functions.sin_all, angle)


@overload
def cos(angle: float) -> float: ...
@overload
def cos(angle: NDArray[Any]) -> FloatArray: ...
def cos(angle: Any) -> Any:
    """Return the cosine of angles in radians."""
    functions = kernels.functions
    return functions.cos_one(angle) if isinstance(angle, float) else _mapped(functions.cos_all, angle)


@overload
def sincos(angle: float) -> tuple[float, float]: ...
@overload
def sincos(angle: NDArray[Any]) -> tuple[FloatArray, FloatArray]: ...
def sincos(angle: Any) -> tuple[Any, Any]:
    """Return sine and cosine of angles in radians, for little more than the price of one."""
    if isinstance(angle, float):
        sine, cosine = kernels.functions.sincos_one(angle)
        return sine, cosine
    values = as_values(angle)
    sines, cosines = np.empty(values.shape), np.empty(values.shape)
    kernels.functions.sincos_all(values.reshape(-1), sines.reshape(-1), cosines.reshape(-1))
    return sines, cosines


@overload
def tan(angle: float) -> float: ...
@overload
def tan(angle: NDArray[Any]) -> FloatArray: ...
def tan(angle: Any) -> Any:
    """Return the tangent of angles in radians."""
    functions = kernels.functions
    return functions.tan_one(angle) if isinstance(angle, float) else _mapped(functions.tan_all, angle)


@overload
def exp(value: float) -> float: ...
@overload
def exp(value: NDArray[Any]) -> FloatArray: ...
def exp(value: Any) -> Any:
    """Return e to the power of ``value``; infinity above 709.78, zero below -745.2."""
    functions = kernels.functions
    return functions.exp_one(value) if isinstance(value, float) else _mapped(functions.exp_all, value)


@overload
def erf(value: float) -> float: ...
@overload
def erf(value: NDArray[Any]) -> FloatArray: ...
def erf(value: Any) -> Any:
    """Return the error function."""
    functions = kernels.functions
    return functions.erf_one(value) if isinstance(value, float) else _mapped(functions.erf_all, value)


@overload
def log(value: float) -> float: ...
@overload
def log(value: NDArray[Any]) -> FloatArray: ...
def log(value: Any) -> Any:
    """Return the natural logarithm; -infinity of zero and NaN below, without a warning or an error."""
    functions = kernels.functions
    return functions.log_one(value) if isinstance(value, float) else _mapped(functions.log_all, value)


@overload
def log1p(value: float) -> float: ...
@overload
def log1p(value: NDArray[Any]) -> FloatArray: ...
def log1p(value: Any) -> Any:
    """Return log(1 + value), accurate for small values."""
    functions = kernels.functions
    return functions.log1p_one(value) if isinstance(value, float) else _mapped(functions.log1p_all, value)


@overload
def expm1(value: float) -> float: ...
@overload
def expm1(value: NDArray[Any]) -> FloatArray: ...
def expm1(value: Any) -> Any:
    """Return e^value - 1, accurate for small values."""
    functions = kernels.functions
    return functions.expm1_one(value) if isinstance(value, float) else _mapped(functions.expm1_all, value)


@overload
def atan2(y: float, x: float) -> float: ...
@overload
def atan2(y: ArrayLike, x: ArrayLike) -> FloatArray: ...
def atan2(y: Any, x: Any) -> Any:
    """Return the direction of (x, y) in radians within [-pi, pi]."""
    if isinstance(y, float) and isinstance(x, float):
        return kernels.functions.atan2_one(y, x)
    return _mapped_pairs(kernels.functions.atan2_all, y, x)


@overload
def hypot(x: float, y: float) -> float: ...
@overload
def hypot(x: ArrayLike, y: ArrayLike) -> FloatArray: ...
def hypot(x: Any, y: Any) -> Any:
    """Return sqrt(x^2 + y^2)."""
    if isinstance(x, float) and isinstance(y, float):
        return kernels.functions.hypot_one(x, y)
    return _mapped_pairs(kernels.functions.hypot_all, x, y)


def dist(point: Any, other: Any) -> float:
    """Return the distance of two points (x, y)."""
    return hypot(float(point[0] - other[0]), float(point[1] - other[1]))


def sinc(value: Any) -> Any:
    """Return sin(pi x) / (pi x), 1 at zero."""
    if isinstance(value, float):
        angle = math.pi * value
        return sin(angle) / angle if angle != 0.0 else 1.0
    return _mapped(kernels.functions.sinc_all, value)


def power(base: Any, exponent: float) -> Any:
    """Return a positive base to the power of a number: e^(exponent log base).

    The error is about |exponent log base| units in the last place; zero to a positive power is zero.
    """
    return exp(exponent * log(base))


def logaddexp(first: Any, second: Any) -> Any:
    """Return log(e^first + e^second) without overflow; infinite where the larger is, -infinity where both are."""
    if isinstance(first, float) and isinstance(second, float):
        most, least = (second, first) if first < second else (first, second)
        return most if math.isinf(most) else most + log1p(exp(least - most))
    larger, smaller = np.maximum(first, second), np.minimum(first, second)
    known = np.where(np.isinf(larger), 0.0, larger)
    return larger + log1p(exp(smaller - known))


@overload
def whole(values: ArrayLike, low: int, high: int) -> NDArray[np.int64]: ...


@overload
def whole(values: ArrayLike, low: int, high: int, kind: type[Whole]) -> NDArray[Whole]: ...


def whole(values: ArrayLike, low: int, high: int, kind: type[Any] = np.int64) -> NDArray[Any]:
    """Return values as whole numbers within [low, high], towards zero; NaN becomes ``low``.

    The bounds are at most 2**53 and fit into ``kind``. What a plain cast makes of NaN, and of what does not fit, each
    processor answers in its own way.
    """
    values = np.asarray(values)
    if values.dtype == np.float32 and max(-low, high) > 2**24:
        values = values.astype(np.float64)  # which holds the bounds
    bounded: NDArray[Any] = np.clip(values, low, high)
    if np.any(unknown := np.isnan(bounded)):
        bounded = np.where(unknown, low, bounded)
    return bounded.astype(kind)


# Wichura, Algorithm AS 241 (1988): ratios of polynomials, the constant first, for the middle and either part of a tail.
_MIDDLE = (
    (
        *(3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4),
        *(4.5921953931549871457e4, 6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3),
    ),
    (
        *(1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3),
        *(2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3),
    ),
)
_NEAR = (
    (
        *(1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0),
        *(1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4),
    ),
    (
        *(1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1),
        *(1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9),
    ),
)
_FAR = (
    (
        *(6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0, 2.96560571828504891230e-1),
        *(2.65321895265761230930e-2, 1.24266094738807843860e-3, 2.71155556874348757815e-5, 2.01033439929228813265e-7),
    ),
    (
        *(1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2),
        *(7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15),
    ),
)


def normal_quantile(probability: float) -> float:
    """Return what a standard normal variable stays below with ``probability`` in (0, 1), to about 1e-15 of it.

    Raises ValueError for a probability out of range.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability = {probability}: expected more than 0 and less than 1")
    aside = probability - 0.5
    if abs(aside) <= 0.425:
        return aside * _ratio(_MIDDLE, 0.180625 - aside * aside)
    depth = math.sqrt(-log(float(probability if aside < 0.0 else 1.0 - probability)))
    return math.copysign(_ratio(_NEAR, depth - 1.6) if depth <= 5.0 else _ratio(_FAR, depth - 5.0), aside)


def _ratio(polynomials: tuple[tuple[float, ...], tuple[float, ...]], value: float) -> float:
    above, below = (reduce(lambda total, factor: total * value + factor, reversed(series)) for series in polynomials)
    return above / below


def as_values(value: Any) -> FloatArray:
    """Return a contiguous array of float64 that kernels take: they are compiled for arrays that can be written."""
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.carray:
        return value
    values = np.asarray(value, dtype=np.float64, order="C")
    return values if values.flags.carray else values.copy()


def _mapped(kernel: Callable[[FloatArray, FloatArray], None], value: Any) -> FloatArray:
    values = as_values(value)
    result = np.empty(values.shape)
    if values.ndim == 1:
        kernel(values, result)
    else:
        kernel(values.reshape(-1), result.reshape(-1))
    return result


def _mapped_pairs(kernel: Callable[[FloatArray, FloatArray, FloatArray], None], first: Any, second: Any) -> FloatArray:
    left, right = as_values(first), as_values(second)
    if left.shape != right.shape:
        left, right = (as_values(each) for each in np.broadcast_arrays(left, right))
    result = np.empty(left.shape)
    kernel(left.reshape(-1), right.reshape(-1), result.reshape(-1))
    return result
