"""Elementary functions: of a float a float, of an array an array of float64 of the same shape; arguments broadcast.

The errors in units in the last place stand in ``dynpf.kernels.elementary64``.
"""

import math
from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels

__all__ = [
    "acos",
    "as_values",
    "asin",
    "atan2",
    "cos",
    "dist",
    "erf",
    "exp",
    "hypot",
    "log",
    "log1p",
    "logaddexp",
    "logsumexp",
    "power",
    "sin",
    "sinc",
    "sincos",
    "tan",
    "whole",
]

FloatArray = NDArray[np.float64]


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


def asin(value: Any) -> Any:
    """Return the arc sine in radians; NaN beyond 1."""
    return atan2(value, _root((1.0 - value) * (1.0 + value)))


def acos(value: Any) -> Any:
    """Return the arc cosine in radians; NaN beyond 1."""
    return atan2(_root((1.0 - value) * (1.0 + value)), value)


def sinc(value: Any) -> Any:
    """Return sin(pi x) / (pi x), 1 at zero."""
    turned = math.pi * np.asarray(value, dtype=np.float64)
    somewhere = np.where(turned == 0.0, 1.0, turned)
    return np.where(turned == 0.0, 1.0, sin(somewhere) / somewhere)


def power(base: Any, exponent: float) -> Any:
    """Return a positive base to the power of a number: e^(exponent log base).

    The error is about |exponent log base| units in the last place; zero to a positive power is zero.
    """
    return exp(exponent * log(base))


def logaddexp(first: Any, second: Any) -> Any:
    """Return log(e^first + e^second) without overflow; -infinity where both are."""
    larger, smaller = np.maximum(first, second), np.minimum(first, second)
    known = np.where(np.isneginf(larger), 0.0, larger)
    return larger + log1p(exp(smaller - known))


def logsumexp(values: FloatArray, axis: int) -> FloatArray:
    """Return log of the sum of e^values along an axis, without overflow; -infinity where all are."""
    largest = np.max(values, axis=axis, keepdims=True)
    known = np.where(np.isfinite(largest), largest, 0.0)
    total: FloatArray = log(np.sum(exp(values - known), axis=axis)) + np.squeeze(known, axis=axis)
    return total


def whole(values: ArrayLike, low: int, high: int) -> NDArray[np.int64]:
    """Return values as whole numbers within [low, high], towards zero; NaN becomes ``low``.

    What a plain cast makes of NaN, and of what does not fit, each processor answers in its own way.
    """
    known = np.where(np.isnan(values), low, values)
    return np.clip(known, low, high).astype(np.int64)


def _root(value: Any) -> Any:
    if isinstance(value, float):
        return math.sqrt(value) if value >= 0.0 else math.nan
    with np.errstate(invalid="ignore"):
        return np.sqrt(value)


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
