"""The light: a polynomial through the background of a grey image, by robust least squares."""

import numpy as np

from dynpf.kernels import linear
from dynpf.kernels.compiler import device, kernel

__all__ = ["fit", "sample", "surface"]

_solve = linear.solve

_CUT = 2.5 * 1.4826  # robust standard deviations, from median absolute ones
_LEAST_CUT = 1.0  # grey levels
_RIDGE = 1e-9


@kernel
def sample(grey, spacing, out):
    """Fill ``out`` (N,) with the mean, to the nearest grey level, of 3 x 3 pixels about every ``spacing``th of (H, W).

    By rows, from half a spacing on; at the border the pixels inside count twice.
    """
    height, width = grey.shape
    at = 0
    for row in range(spacing // 2, height, spacing):
        for column in range(spacing // 2, width, spacing):
            total = 0
            for i in range(row - 1, row + 2):
                for j in range(column - 1, column + 2):
                    total += int(grey[_mirrored(i, height), _mirrored(j, width)])
            out[at] = (total + 4) // 9
            at += 1


@device
def _mirrored(index, size):
    return 1 if index < 0 else (size - 2 if index >= size else index)


@kernel
def fit(terms, values, degree, coefficients):
    """Fill ``coefficients`` (T,) of the polynomial with ``terms`` (N, T), lower degrees first, through ``values`` (N,).

    Values that stand out by more than 2.5 robust standard deviations are left out; the degree is raised one at a time.
    """
    count, size = terms.shape
    departures = np.empty(count)
    coefficients[:] = 0.0
    coefficients[0] = np.median(values)
    for step in range(degree + 2):
        order = min(step, degree)
        for n in range(count):
            level = 0.0
            for t in range(size):
                level += terms[n, t] * coefficients[t]
            departures[n] = abs(values[n] - level)
        cut = max(_CUT * np.median(departures), _LEAST_CUT)
        used = (order + 1) * (order + 2) // 2
        normal, right = np.zeros((1, used, used)), np.zeros((1, used, 1))
        for n in range(count):
            if departures[n] > cut:
                continue
            for i in range(used):
                right[0, i, 0] += terms[n, i] * values[n]
                for j in range(i + 1):
                    normal[0, i, j] += terms[n, i] * terms[n, j]
        for i in range(used):
            normal[0, i, i] += _RIDGE
            for j in range(i):
                normal[0, j, i] = normal[0, i, j]
        _solve(normal, right)
        coefficients[:] = 0.0
        for i in range(used):
            coefficients[i] = right[0, i, 0]


@kernel
def surface(matrix, powers_y, powers_x, out):
    """Fill ``out`` (H, W), float32, with sum of matrix[i, j] y^i x^j, kept within 0 and 255.

    ``powers_y`` are (H, P) and ``powers_x`` (P, W), ``matrix`` (P, P).
    """
    size = len(matrix)
    height, width = out.shape
    across, level = np.empty((size, width)), np.empty(width)
    for i in range(size):
        across[i, :] = 0.0
        for j in range(size):
            factor = matrix[i, j]
            for x in range(width):
                across[i, x] += factor * powers_x[j, x]
    for y in range(height):
        level[:] = 0.0
        for i in range(size):
            factor = powers_y[y, i]
            for x in range(width):
                level[x] += factor * across[i, x]
        for x in range(width):
            out[y, x] = min(max(level[x], 0.0), 255.0)
