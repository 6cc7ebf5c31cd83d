"""Gauges: what the host of a node is told of its process, and tells it."""

from typing import Protocol

__all__ = ["Gauges"]


class Gauges(Protocol):
    """Measurements of the process, for diagnostics and for those who watch it; nothing in the run depends on them."""

    def stepping(self, tick: int) -> None:
        """Note that a step of the node begins, which may take long."""

    def stopwatch_s(self) -> float:
        """Return the seconds of a clock."""

    def waiting(self) -> int:
        """Return the number of arrivals that wait to be handled."""
