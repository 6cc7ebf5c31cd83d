"""Arrays as kernels take them. A kernel does not see where an array ends, so shapes are looked at before."""

from typing import Any

from dynpf.portable.functions import as_values
from dynpf.types import FloatArray

__all__ = ["shaped"]


def shaped(what: str, values: Any, *shape: int) -> FloatArray:
    """Return the values as a contiguous array of float64; raises ValueError if they are of another shape."""
    array = as_values(values)
    if array.shape != shape:
        raise ValueError(f"{what} of shape {array.shape}; expected {shape}")
    return array
