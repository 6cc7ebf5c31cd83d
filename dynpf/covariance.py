"""The square root of a covariance, which may be singular. No LAPACK, whose bits differ by machine."""

import numpy as np

from dynpf import kernels
from dynpf.portable.functions import as_values
from dynpf.types import FloatArray

__all__ = ["negative_eigenvalue", "semidefinite_root"]


def semidefinite_root(covariance: FloatArray) -> FloatArray:
    """Return the lower triangular L with L L' = covariance (D, D), which may be singular.

    Cholesky's decomposition; a pivot is zero when rounding explains it, judged by its own element of the diagonal, so
    that units may differ by any factor. Raises ValueError for a matrix with a negative eigenvalue.
    """
    given = as_values(covariance)
    root = np.empty(given.shape)
    if not kernels.roots.root(given, root):
        raise negative_eigenvalue(given)
    return root


def negative_eigenvalue(covariance: FloatArray) -> ValueError:
    """Return the error for a covariance with a negative eigenvalue."""
    return ValueError(f"a covariance has no negative eigenvalue; {covariance.tolist()} has one")
