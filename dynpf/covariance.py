"""Square roots of covariances: of one, (D, D), or of one a particle along the last axis, (D, D, N).

Both may be singular: a direction without variance has a column of zeros. No LAPACK, whose bits differ by machine.
"""

import math

import numpy as np

from dynpf.se2 import FloatArray

__all__ = ["cholesky", "semidefinite_root", "solve_lower", "solve_upper"]

_ROUNDING = 1e-12
"""Share of its own variance below which a pivot is rounding: the direction is a combination of those before it."""


def semidefinite_root(covariance: FloatArray) -> FloatArray:
    """Return the lower triangular L with L L' = covariance (D, D), which may be singular: columns without noise are 0.

    Cholesky's decomposition; a pivot is zero when rounding explains it, judged by its own element of the diagonal, so
    that units may differ by any factor. Raises ValueError for a matrix with a negative eigenvalue.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    left = covariance.copy()
    root = np.zeros_like(left)
    for k, own in enumerate(scale):
        pivot = left[k, k]
        if pivot > _ROUNDING * own**2:
            root[k:, k] = left[k:, k] / math.sqrt(pivot)
            left -= np.outer(root[:, k], root[:, k])
        # A pivot of zero leaves its whole column zero, if no eigenvalue is negative.
        elif pivot < -_ROUNDING * own**2 or np.any(np.abs(left[k:, k]) > math.sqrt(_ROUNDING) * own * scale[k:]):
            raise ValueError(f"a covariance has no negative eigenvalue; {covariance.tolist()} has one")
    return root


def cholesky(matrices: FloatArray) -> FloatArray:
    """Return lower triangular L with L L^T = A of positive semi-definite A, shape (D, D, N): loops over D only."""
    size = matrices.shape[0]
    lower = np.zeros_like(matrices)
    least = _ROUNDING * np.maximum(matrices[np.arange(size), np.arange(size)], 0.0)
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
