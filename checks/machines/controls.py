"""Controls: results known to differ between choices of kernels, so that a setting that changes nothing is found out.

Each takes the same numbers everywhere, made by integers alone, and returns what was computed of them. dynpf may use
none of these functions where a result is compared: that is what the matrix proves.
"""

import hashlib
import math
from collections.abc import Callable, Mapping

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["CONTROLS", "PROCESSOR", "control_digests"]

FloatArray = NDArray[np.float64]


def control_digests() -> dict[str, str]:
    """Return the digest of each control's result, as this process computes it."""
    return {name: hashlib.sha256(compute()).hexdigest()[:16] for name, compute in CONTROLS.items()}


def _numbers(count: int) -> FloatArray:
    """Return numbers in [0, 1), (count,), by integer arithmetic: the same on every machine."""
    mixed = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x5851F42D4C957F2D)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(32)
    return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _products() -> bytes:
    """OpenBLAS: a product and an inverse of matrices."""
    matrix = _numbers(64 * 64).reshape(64, 64)
    return (matrix @ matrix).tobytes() + np.linalg.inv(matrix + 8.0 * np.eye(64)).tobytes()


def _long_dot() -> bytes:
    """OpenBLAS: a scalar product long enough to be shared out among threads."""
    numbers = _numbers(300_000)
    return np.float64(np.dot(numbers, numbers)).tobytes()


def _numpy() -> bytes:
    """NumPy: elementary functions of its own, and the order in which an unstable sort leaves ties."""
    numbers = 8.0 * _numbers(20_011) - 4.0
    functions = b"".join(compute(numbers).tobytes() for compute in (np.exp, np.tanh, np.cbrt, np.tan))
    return functions + np.argsort((3.0 * numbers).astype(np.int64)).astype(np.int64).tobytes()


def _libm() -> bytes:
    """The C library: math.sin and others."""
    numbers = (8.0 * _numbers(20_011) - 4.0).tolist()
    return np.array([(math.sin(x), math.cos(x), math.exp(x), math.pow(x + 5.0, 1.7)) for x in numbers]).tobytes()


def _image() -> NDArray[np.float32]:
    return (7.0 * _numbers(200 * 300) - 3.0).astype(np.float32).reshape(200, 300)


def _opencv() -> bytes:
    """OpenCV's own kernels: directions, a filter and a warp."""
    image = _image()
    kernel = _numbers(49).astype(np.float32).reshape(7, 7)
    turn = np.array([[0.9, 0.1, 3.3], [-0.1, 1.1, 2.2]])
    results = (
        cv2.phase(image, image[::-1].copy()),
        cv2.filter2D(image, -1, kernel),
        cv2.warpAffine(image, turn, (300, 200)),
    )
    return b"".join(np.asarray(result).tobytes() for result in results)


def _ipp() -> bytes:
    """Intel's library in OpenCV: logarithm, a resized image, a Fourier transform."""
    image = _image()
    results = (cv2.log(np.abs(image) + np.float32(1.0)), cv2.resize(image, (171, 91)), cv2.dft(image))
    return b"".join(np.asarray(result).tobytes() for result in results)


@numba.njit(fastmath=True)
def _sum_of_squares(numbers):  # type: ignore[no-untyped-def]
    total = 0.0
    for number in numbers:
        total += number * number
    return total


def _numba() -> bytes:
    """Numba: a sum in an order that the compiler may choose, which goes by the width of vectors. Ours may not."""
    return np.float64(_sum_of_squares(_numbers(20_011))).tobytes()


def _python() -> bytes:
    """Python: sum() of floats, which compensates since 3.12."""
    return np.float64(sum(_numbers(20_011).tolist())).tobytes()


def _hashing() -> bytes:
    """Python: the order of a set of texts."""
    return repr(set("abcdefghijklmnopqrstuvwxyz")).encode()


CONTROLS: Mapping[str, Callable[[], bytes]] = {
    "products": _products,
    "long dot": _long_dot,
    "numpy": _numpy,
    "libm": _libm,
    "opencv": _opencv,
    "ipp": _ipp,
    "numba": _numba,
    "float sum": _python,
    "set order": _hashing,
}

PROCESSOR = ("products", "long dot", "numpy", "libm", "opencv", "ipp", "numba")
"""The controls that another processor should change, beside those that another Python does."""
