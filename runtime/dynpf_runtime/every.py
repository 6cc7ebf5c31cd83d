"""At most once in a period of logical time: for what is said or shown more seldom than a node steps."""

from typing import Annotated

import msgspec
from msgspec import Meta

__all__ = ["Every"]


class Every(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A period of logical time, s.

    A node keeps the stamp at which it last did what it does so often, None before the first time: that is all its
    state. So a period can be a constant, or a parameter of a node.
    """

    period_s: Annotated[float, Meta(ge=0.0)]

    def due(self, stamp_ns: int, last_ns: int | None) -> bool:
        """Return whether it is time at ``stamp_ns``, nanoseconds: always the first time and where the period is 0."""
        return last_ns is None or stamp_ns - last_ns >= round(self.period_s * 1e9)
