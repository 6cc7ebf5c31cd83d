"""Float32 exponentials and logarithms by way of float64, down to where weights are zero."""

import numpy as np

from dynpf import portable
from dynpf.types import Floats

__all__ = ["exp", "log"]


def exp(values: Floats) -> Floats:
    """Return e to the power of each value, float32."""
    return portable.exp(values).astype(np.float32)


def log(values: Floats) -> Floats:
    """Return the natural logarithm of each value, float32; -inf of zero."""
    return portable.log(values).astype(np.float32)
