"""Maps that replace one another at known times."""

import math
from bisect import bisect_right
from collections.abc import Iterable
from typing import Generic, TypeVar

__all__ = ["MapTimeline"]

MapT = TypeVar("MapT")


class MapTimeline(Generic[MapT]):
    """Which map holds when: ``starts`` in seconds, ascending, and the ``maps`` that hold from each on."""

    def __init__(self, entries: Iterable[tuple[float, MapT]]) -> None:
        """Take (start, map) of each, in order of time.

        Raises ValueError where there is none, or a start is not finite or not above the one before.
        """
        rows = tuple(entries)
        if not rows:
            raise ValueError("a timeline without maps; expected at least one (start, map)")
        self.starts = tuple(float(start) for start, _ in rows)
        self.maps = tuple(entry for _, entry in rows)
        for index, start in enumerate(self.starts):
            if not math.isfinite(start):
                raise ValueError(f"map {index} starts at {start}; expected a finite time in seconds")
            if index and start <= self.starts[index - 1]:
                raise ValueError(f"map {index} starts at {start}; expected a time after {self.starts[index - 1]}")

    @property
    def changes(self) -> tuple[float, ...]:
        """The times, in seconds, at which one map gives way to the next."""
        return self.starts[1:]

    def at(self, time: float) -> MapT:
        """Return the map that holds at ``time`` in seconds: from its start on; the first one also before its start.

        Raises ValueError for a time that is not a number.
        """
        if math.isnan(time):
            raise ValueError(f"time = {time}; expected seconds")
        return self.maps[max(bisect_right(self.starts, time) - 1, 0)]
