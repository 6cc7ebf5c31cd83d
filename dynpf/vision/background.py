"""The light: a smooth surface through the background, and the image freed of it."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels

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
    terms = _terms(height, width, spacing, degree)
    values, coefficients = np.empty(len(terms)), np.empty(terms.shape[1])
    kernels.background.sample(np.require(grey, requirements=["C", "W"]), spacing, values)
    kernels.background.fit(terms, values, degree, coefficients)
    matrix = np.zeros((degree + 1, degree + 1))
    for (i, j), value in zip(_exponents(degree), coefficients, strict=True):
        matrix[i, j] = value
    background = np.empty((height, width), dtype=np.float32)
    kernels.background.surface(matrix, *_all_powers(height, width, degree), background)
    return background


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


@lru_cache(maxsize=4)
def _all_powers(height: int, width: int, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Powers of the rows (H, degree + 1) and of the columns (degree + 1, W)."""
    across = _powers(np.arange(width), width, degree).T
    return _powers(np.arange(height), height, degree), np.ascontiguousarray(across)


def _exponents(degree: int) -> list[tuple[int, int]]:
    return [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]


def _powers(index: NDArray[np.intp], count: int, degree: int) -> NDArray[np.float64]:
    """Powers 0..degree (n, degree + 1) of the centres of the pixels `index` among `count` that share [-1, 1]."""
    powers = np.ones((len(index), degree + 1))
    for i in range(degree):
        powers[:, i + 1] = powers[:, i] * ((2 * index + 1) / count - 1)
    return powers
