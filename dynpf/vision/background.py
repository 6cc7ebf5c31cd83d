"""The light: a smooth surface through the background, and the image freed of it."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["estimate_background", "flatten"]

_CELLS = 32  # along the shorter side
_DARKEST = 16.0  # grey level below which the background is too dark to divide by


def estimate_background(grey: NDArray[np.uint8], degree: int = 4) -> NDArray[np.float32]:
    """Return the background's grey level at each pixel (H, W) as a polynomial of the given total degree.

    Robust least squares on the means of coarse cells: cells that stand out by more than 2.5 robust standard
    deviations are left out, and the degree is raised one at a time so that discs cannot bend the surface. Holds as
    long as more than half of the image is background.
    """
    height, width = grey.shape
    block = max(1, min(height, width) // _CELLS)
    columns, rows = max(1, width // block), max(1, height // block)
    cells = cv2.resize(grey.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
    terms = _terms(rows, columns, degree)  # summed by einsum: its order does not depend on threads, as BLAS's may
    values = cells.ravel()
    coefficients = np.zeros(terms.shape[1])
    coefficients[0] = np.median(values)
    for order in (*range(degree + 1), degree, degree):
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
    across = np.einsum("ij,xj->ix", matrix, _powers(width, degree))
    full = np.einsum("yi,ix->yx", _powers(height, degree), across)
    return np.asarray(np.clip(full, 0, 255), dtype=np.float32)


def flatten(grey: NDArray[np.uint8], background: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the contrast to the background (H, W) in grey levels at the average light; 0 is background.

    Light multiplies what it falls on, so the difference is divided by the background as well.
    """
    light = np.maximum(background, _DARKEST)
    gain = light.mean(dtype=np.float64).astype(np.float32) / light
    return np.asarray((grey - background) * gain, dtype=np.float32)


@lru_cache(maxsize=4)
def _terms(rows: int, columns: int, degree: int) -> NDArray[np.float64]:
    """The polynomial's terms at each cell (rows * columns, terms), lower degrees first."""
    powers_y, powers_x = _powers(rows, degree), _powers(columns, degree)
    terms = [np.outer(powers_y[:, i], powers_x[:, j]).ravel() for i, j in _exponents(degree)]
    return np.stack(terms, axis=1)


def _exponents(degree: int) -> list[tuple[int, int]]:
    return [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]


def _powers(count: int, degree: int) -> NDArray[np.float64]:
    """Powers 0..degree of the centres of `count` cells that share [-1, 1], (count, degree + 1)."""
    centre = (2 * np.arange(count) + 1) / count - 1
    return np.vander(centre, degree + 1, increasing=True)
