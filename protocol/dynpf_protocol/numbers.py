"""Numbers within a range, as messages and control messages have them; decoding checks the range."""

from typing import Annotated

from msgspec import Meta

__all__ = ["Angle", "Count", "Count63", "NonNegative", "Positive"]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
"""Radians."""
Count = Annotated[int, Meta(ge=0)]
Count63 = Annotated[int, Meta(ge=0, le=2**63 - 1)]
"""A count that fits into a signed integer of 64 bits."""
