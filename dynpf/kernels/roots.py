"""Roots of covariances, which may be singular: Cholesky's decomposition in float64.

A pivot is zero when rounding explains it, judged by its own element of the diagonal, so that units may differ by any
factor.
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel

__all__ = ["ROUNDING", "lower_root", "root"]

ROUNDING = 1e-12
"""Share of its own variance below which a pivot is rounding: the direction is a combination of those before it."""


@device
def _root_in_order(covariance, out):
    """Fill ``out`` (D, D) with the lower triangular L, L L^T = P, taking the pivots as they come.

    Returns False where P has a negative eigenvalue, or seems to: a small pivot divides, and makes rounding large.
    """
    size = covariance.shape[0]
    left, scale = covariance.copy(), np.empty(size)
    for k in range(size):
        scale[k] = np.sqrt(covariance[k, k]) if covariance[k, k] > 0.0 else 0.0
        for j in range(size):
            out[k, j] = 0.0
    for k in range(size):
        pivot, own = left[k, k], scale[k] * scale[k]
        if pivot > ROUNDING * own:
            for i in range(k, size):
                out[i, k] = left[i, k] / np.sqrt(pivot)
            for i in range(k, size):
                for j in range(k, size):
                    left[i, j] -= out[i, k] * out[j, k]
            continue
        # A pivot of zero leaves its whole column zero, if no eigenvalue is negative.
        if pivot < -ROUNDING * own:
            return False
        for i in range(k, size):
            if abs(left[i, k]) > np.sqrt(ROUNDING) * scale[k] * scale[i]:
                return False
    return True


@device
def _root_by_size(covariance, out):
    """Fill ``out`` (D, D) with the lower triangular L, L L^T = P; return whether P has no negative eigenvalue.

    Each pivot is the greatest left, as a share of its own element of the diagonal, so that what is left at last is
    rounding (Higham, Accuracy and Stability of Numerical Algorithms, 10.3). Rotations then make the root triangular.
    """
    size = covariance.shape[0]
    left, done = covariance.copy(), np.zeros(size, np.bool_)
    out[:] = 0.0
    for column in range(size):
        chosen, greatest = -1, ROUNDING
        for k in range(size):
            if not done[k] and left[k, k] > greatest * covariance[k, k]:
                chosen, greatest = k, left[k, k] / covariance[k, k]
        if chosen < 0:
            break
        pivot = np.sqrt(left[chosen, chosen])
        for i in range(size):
            if not done[i]:
                out[i, column] = left[i, chosen] / pivot
        for i in range(size):
            for j in range(size):
                left[i, j] -= out[i, column] * out[j, column]
        done[chosen] = True
    for i in range(size):
        for j in range(size):
            if not done[i] and not done[j]:
                own = np.sqrt(max(covariance[i, i], 0.0)) * np.sqrt(max(covariance[j, j], 0.0))
                if abs(left[i, j]) > ROUNDING * own:
                    return False
    _make_triangular(out)
    return True


@device
def _make_triangular(root):
    """Rotate pairs of the columns of ``root`` (D, D) until all above its diagonal is zero; root root^T stays."""
    size = root.shape[0]
    for i in range(size):
        for j in range(i + 1, size):
            if root[i, j] == 0.0:
                continue
            length = np.sqrt(root[i, i] * root[i, i] + root[i, j] * root[i, j])
            cosine, sine = root[i, i] / length, root[i, j] / length
            for k in range(i, size):
                here, there = root[k, i], root[k, j]
                root[k, i], root[k, j] = cosine * here + sine * there, cosine * there - sine * here
            root[i, j] = 0.0


@device
def lower_root(covariance, out):
    """Fill ``out`` (D, D) with the lower triangular L, L L^T = P; return whether P has no negative eigenvalue."""
    return _root_in_order(covariance, out) or _root_by_size(covariance, out)


@kernel
def root(covariance, out):
    """Fill ``out`` (D, D) with the lower triangular L, L L^T = P; return whether P has no negative eigenvalue."""
    return lower_root(covariance, out)
