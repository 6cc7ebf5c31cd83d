"""Small symmetric matrices, one a particle, along the last axis: (D, D, N). Loops over D, vectors over N."""

import numpy as np

from dynpf.se2 import FloatArray

__all__ = ["cholesky", "solve_lower", "solve_upper"]


def cholesky(matrices: FloatArray) -> FloatArray:
    """Return lower triangular L with L L^T = A of positive semi-definite A, shape (D, D, N).

    A direction without variance has a column of zeros.
    """
    size = matrices.shape[0]
    lower = np.zeros_like(matrices)
    # Below this share of its own variance a pivot is rounding: the direction is a combination of those before it.
    least = 1e-14 * np.maximum(matrices[np.arange(size), np.arange(size)], 0.0)
    for j in range(size):
        pivot = matrices[j, j] - np.sum(lower[j, :j] ** 2, axis=0)
        flat = pivot <= least[j]
        root = np.sqrt(np.where(flat, 1.0, pivot))
        lower[j, j] = np.where(flat, 0.0, root)
        for i in range(j + 1, size):
            rest = matrices[i, j] - np.sum(lower[i, :j] * lower[j, :j], axis=0)
            lower[i, j] = np.where(flat, 0.0, rest / root)
    return lower


def solve_lower(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Return x with L x = b for each column; L (D, D, N), b (D, N)."""
    solution = np.empty_like(right)
    for i in range(right.shape[0]):
        solution[i] = (right[i] - np.sum(lower[i, :i] * solution[:i], axis=0)) / lower[i, i]
    return solution


def solve_upper(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Return x with L^T x = b for each column; L (D, D, N), b (D, N)."""
    solution = np.empty_like(right)
    for i in reversed(range(right.shape[0])):
        solution[i] = (right[i] - np.sum(lower[i + 1 :, i] * solution[i + 1 :], axis=0)) / lower[i, i]
    return solution
