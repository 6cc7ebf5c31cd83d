"""What has arrived and waits: of bounded size, whoever is slow, and what has no place is told in its place."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Arrivals"]

_T = TypeVar("_T")


class Arrivals(Generic[_T]):
    """Items that wait, in the order of arrival: at most ``most`` bytes of them, and none of more than ``largest``."""

    def __init__(self, most: int, largest: int) -> None:
        self._most, self._largest = most, largest
        self._queue: deque[tuple[_T, int]] = deque()
        self._lock = threading.Lock()
        self._bytes = 0

    @property
    def waiting(self) -> bool:
        """Whether an item waits."""
        return bool(self._queue)

    def put(self, item: _T, size: int, instead: Callable[[_T | None], _T | None] | None = None) -> bool:
        """Add an item of ``size`` bytes; return whether there was a place for it.

        If there is none, ``instead`` is given the item that came last and still waits, None if none does, and returns
        one that is added instead whatever there is, or None if it has noted the loss in the last one.
        """
        with self._lock:
            if size <= self._largest and self._bytes + size <= self._most:
                self._queue.append((item, size))
                self._bytes += size
                return True
            if instead is not None:
                added = instead(self._queue[-1][0] if self._queue else None)
                if added is not None:
                    self._queue.append((added, 0))
            return False

    def take(self) -> _T | None:
        """Return the next item, None if none waits."""
        with self._lock:
            if not self._queue:
                return None
            item, size = self._queue.popleft()
            self._bytes -= size
            return item
