"""The light: a smooth surface through the background, and the image freed of it."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["estimate_background", "flatten"]

_SAMPLES = 28  # along the shorter side
_DARKEST = 16.0  # grey level below which the background is too dark to divide by


def estimate_background(grey: NDArray[np.uint8], degree: int = 4) -> NDArray[np.float32]:
    """Return the background's grey level at each pixel (H, W) as a polynomial of the given total degree.

    Robust least squares on samples of the image: those that stand out by more than 2.5 robust standard deviations
    are left out, and the degree is raised one at a time so that discs cannot bend the surface. Holds as long as clearly
    more than half of the image is background.
    """
    height, width = grey.shape
    spacing = max(1, min(height, width) // _SAMPLES)
    samples = cv2.blur(grey, (3, 3))[spacing // 2 :: spacing, spacing // 2 :: spacing].astype(np.float64)
    # summed by einsum: its order does not depend on threads, as BLAS's may
    terms = _terms(height, width, spacing, degree)
    values = samples.ravel()
    coefficients = np.zeros(terms.shape[1])
    coefficients[0] = np.median(values)
    for order in (*range(degree + 1), degree):
        departure = np.abs(values - np.einsum("kt,t->k", terms, coefficients))
        inlier = departure <= max(2.5 * 1.4826 * float(np.median(departure)), 1.0)
        used = (order + 1) * (order + 2) // 2
        chosen = terms[inlier, :used]
        normal = np.einsum("ki,kj->ij", chosen, chosen) + 1e-9 * np.eye(used)
        coefficients = np.zeros(terms.shape[1])
        coefficients[:used] = np.linalg.solve(normal, np.einsum("kt,k->t", chosen, values[inlier]))
    matrix = np.zeros((degree + 1, degree + 1))
    for (i, j), value in zip(_exponents(degree), coefficients, strict=True):
        matrix[i, j] = value
    rows, columns = np.arange(height), np.arange(width)
    across = np.einsum("ij,xj->ix", matrix, _powers(columns, width, degree))
    full = np.einsum("yi,ix->yx", _powers(rows, height, degree), across)
    return np.asarray(np.clip(full, 0, 255), dtype=np.float32)


def flatten(grey: NDArray[np.uint8], background: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the contrast to the background (H, W) in grey levels at the average light; 0 is background.

    Light multiplies what it falls on, so the difference is divided by the background as well.
    """
    light = np.maximum(background, _DARKEST)
    gain = light.mean(dtype=np.float64).astype(np.float32) / light
    return np.asarray((grey - background) * gain, dtype=np.float32)


@lru_cache(maxsize=4)
def _terms(height: int, width: int, spacing: int, degree: int) -> NDArray[np.float64]:
    """The polynomial's terms at each sample (samples, terms), lower degrees first."""
    powers_y = _powers(np.arange(spacing // 2, height, spacing), height, degree)
    powers_x = _powers(np.arange(spacing // 2, width, spacing), width, degree)
    terms = [np.outer(powers_y[:, i], powers_x[:, j]).ravel() for i, j in _exponents(degree)]
    return np.stack(terms, axis=1)


def _exponents(degree: int) -> list[tuple[int, int]]:
    return [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]


def _powers(index: NDArray[np.intp], count: int, degree: int) -> NDArray[np.float64]:
    """Powers 0..degree (n, degree + 1) of the centres of the pixels `index` among `count` that share [-1, 1]."""
    return np.vander((2 * index + 1) / count - 1, degree + 1, increasing=True)
