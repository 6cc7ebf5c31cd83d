"""Where a filter's particles begin."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.se2 import FloatArray

__all__ = ["KnownStart", "around"]

NonNegative = Annotated[float, Meta(ge=0.0)]


class KnownStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="known"):
    """A pose known up to Gaussian errors of the given standard deviations; metres and radians."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    sigma_position: NonNegative = 0.05
    sigma_heading: NonNegative = 0.05


def around(start: KnownStart, count: int, rng: np.random.Generator) -> FloatArray:
    """Return ``count`` poses drawn around a known one, shape (3, count)."""
    mean = np.array([start.x, start.y, start.theta])
    sigma = np.array([start.sigma_position, start.sigma_position, start.sigma_heading])
    return mean[:, None] + sigma[:, None] * rng.standard_normal((3, count))
