"""Types that the whole library shares: arrays of numbers, and numbers within a range, checked where they come in."""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

__all__ = [
    "Count",
    "Float32s",
    "FloatArray",
    "Floats",
    "Int32s",
    "NonNegative",
    "OpenShare",
    "Positive",
    "Rate",
    "Share",
]

FloatArray = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
"""Floats of either precision: particles and weights are float32 in the built-in models."""
Float32s = NDArray[np.float32]
Int32s = NDArray[np.int32]

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Rate = Annotated[float, Meta(gt=0.0, le=1.0)]
"""A share that is not nothing, such as that of the way to the newest value."""
OpenShare = Annotated[float, Meta(gt=0.0, lt=1.0)]
Count = Annotated[int, Meta(ge=1)]
