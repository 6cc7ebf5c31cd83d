"""Rate limits in logical time, for messages that a node publishes less often than it steps."""

import msgspec

from dynpf.types import NonNegative

__all__ = ["Every"]


class Every(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A period of logical time, s.

    The period itself has no state and can be a constant or a parameter of a node. The node keeps the stamp of the last
    time, None before the first.
    """

    period_s: NonNegative

    def due(self, stamp_ns: int, last_ns: int | None) -> bool:
        """Return whether the period has passed since ``last_ns`` at ``stamp_ns``, ns; always true before the first."""
        return last_ns is None or stamp_ns - last_ns >= round(self.period_s * 1e9)
