"""Maps that replace one another at known times."""

import math
from bisect import bisect_right
from dataclasses import dataclass
from operator import itemgetter
from typing import Generic, TypeVar

__all__ = ["MapTimeline"]

MapT = TypeVar("MapT")


@dataclass(frozen=True)
class MapTimeline(Generic[MapT]):
    """Which map holds when.

    ``entries``: (start in seconds, map) of each, in order of time. Raises ValueError where there is none, or a start is
    not finite or not after the one before.
    """

    entries: tuple[tuple[float, MapT], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "entries", tuple((float(start), held) for start, held in self.entries))
        if not self.entries:
            raise ValueError("a timeline without maps; expected at least one (start, map)")
        before = -math.inf
        for index, (start, _) in enumerate(self.entries):
            if not math.isfinite(start):
                raise ValueError(f"map {index} starts at {start}; expected a finite time in seconds")
            if start <= before:
                raise ValueError(f"map {index} starts at {start}; expected a time after {before}")
            before = start

    @property
    def changes(self) -> tuple[float, ...]:
        """The times, in seconds, at which one map gives way to the next."""
        return tuple(start for start, _ in self.entries[1:])

    def at(self, time: float) -> MapT:
        """Return the map that holds at ``time`` in seconds: from its start on; the first one also before its start.

        Raises ValueError for a time that is not a number.
        """
        if math.isnan(time):
            raise ValueError(f"time = {time}; expected seconds")
        index = bisect_right(self.entries, time, key=itemgetter(0))
        return self.entries[max(index - 1, 0)][1]
