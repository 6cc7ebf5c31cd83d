"""Exponentials and logarithms of float32 by way of float64.

NumPy's own for float32 differ in the last bit from processor to processor; rounded from float64 they hardly ever do.
"""

import numpy as np

from dynpf.se2 import Floats

__all__ = ["exp", "log"]


def exp(values: Floats) -> Floats:
    """Return e to the power of each value, float32."""
    return np.exp(values, dtype=np.float64).astype(np.float32)


def log(values: Floats) -> Floats:
    """Return the natural logarithm of each value, float32; -inf of zero, without a warning."""
    with np.errstate(divide="ignore"):
        return np.log(values, dtype=np.float64).astype(np.float32)
