"""The agenda: what is to happen when, in simulated time."""

import heapq
from collections.abc import Callable
from random import Random

__all__ = ["Agenda"]


class Agenda:
    """Acts by their times; those of one time in the order in which they were put there."""

    def __init__(self, random: Random) -> None:
        self.now_ns = 0
        self.random = random
        self._count = 0
        self._acts: list[tuple[int, int, Callable[[], None]]] = []

    def __bool__(self) -> bool:
        return bool(self._acts)

    @property
    def next_ns(self) -> int:
        """When the next act is due."""
        return self._acts[0][0]

    def at(self, at_ns: int, act: Callable[[], None]) -> None:
        """Have ``act`` called at a time."""
        self._count += 1
        heapq.heappush(self._acts, (at_ns, self._count, act))

    def step(self) -> None:
        """Go on to the next act, and do it."""
        at_ns, _, act = heapq.heappop(self._acts)
        self.now_ns = max(self.now_ns, at_ns)
        act()

    def draw(self, most_ns: int) -> int:
        """Return a duration of up to ``most_ns``."""
        return int(self.random.random() * most_ns)
