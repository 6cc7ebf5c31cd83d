"""Standstill: whether a run has made no step for long."""

__all__ = ["Standstill"]

STILL_NS = 5_000_000_000
"""How long a run in which two have spoken under one name may stand still."""


class Standstill:
    """Looks at the number of steps of a run again and again."""

    def __init__(self) -> None:
        self._steps, self._since_ns = 0, 0

    def lasts(self, steps: int, now_ns: int, *, paused: bool) -> bool:
        """Return whether there have been no more than these for STILL_NS, and the run is not paused."""
        if steps != self._steps or paused:
            self._steps, self._since_ns = steps, now_ns
        return now_ns > self._since_ns + STILL_NS
