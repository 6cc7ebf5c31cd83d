"""The account of one publisher's numbered messages: which never came, came again, or late, and which had no room here.

Numbers count modulo 2**32, as an MCAP file holds them, so that who records and who reads the file find the same.
"""

from bisect import bisect_left, bisect_right

from dynpf_formats.ros2.attachment import Lost

__all__ = ["MOST_RANGES", "Series"]

MOST_RANGES = 1000
"""How many ranges of missing numbers are kept, of each publisher; those beyond are counted."""

_WRAP = 2**32


class Series:
    """What has come of one publisher on one topic. The first number that comes is the beginning.

    ``received`` counts messages, with repetitions; ``dropped`` those that came and that the recorder had no room for;
    ``duplicates`` those that came again; ``late`` those that came after a later one; ``restarts`` how often the
    publisher began to count anew. A lower number is a new beginning if it was published later than the highest.
    """

    def __init__(self) -> None:
        self.received = self.dropped = self.duplicates = self.late = self.restarts = 0
        self._first = self._next = self._newest_ns = 0
        self._begun = False
        self._open: list[Lost] = []  # of numbers that may still come, in order
        self._closed: list[Lost] = []
        self._unlisted = 0

    @property
    def missing(self) -> int:
        """How many numbers never came."""
        return sum(last - first + 1 for first, last in self.lost) + self._unlisted

    @property
    def lost(self) -> tuple[Lost, ...]:
        """The numbers that never came, in the order of the publisher; at most twice MOST_RANGES ranges."""
        return (*self._closed, *self._open)

    def see(self, number: int, stamp_ns: int) -> Lost | None:
        """Note a message that is recorded, by its number and when it was published; return what is missing before it.

        What is missing may still come: ``lost`` tells what has not in the end.
        """
        self.received += 1
        return self._arrived(number, number, stamp_ns)

    def drop(self, first: int, last: int, stamp_ns: int) -> None:
        """Note messages that came in this order, the last published at ``stamp_ns``, and that are not recorded."""
        self.dropped += (last - first) % _WRAP + 1
        self._arrived(first, last, stamp_ns)

    def _arrived(self, first: int, last: int, stamp_ns: int) -> Lost | None:
        size = (last - first) % _WRAP
        first = self._unwrapped(first)
        last = first + size
        if self._begun and first < self._next and stamp_ns > self._newest_ns:
            self.restarts += 1
            self._close(len(self._open))
            self._begun = False
        if not self._begun:
            self._begun = True
            self._first, self._next, self._newest_ns = first, last + 1, stamp_ns
            return None
        gap = Lost(self._next, first - 1) if first > self._next else None
        if first < self._next:
            self._came_late(first, min(last, self._next - 1))
        if gap is not None:
            self._open.append(gap)
        if last >= self._next:
            self._next, self._newest_ns = last + 1, max(stamp_ns, self._newest_ns)
        self._close(len(self._open) - MOST_RANGES)
        return gap

    def _came_late(self, first: int, last: int) -> None:
        """Note numbers that are all below the next one."""
        if first < self._first:
            if last + 1 < self._first:
                self._open.insert(0, Lost(last + 1, self._first - 1))
            new = min(last, self._first - 1)
            self.late += new - first + 1
            self._first, first = first, new + 1
        begin = bisect_left(self._open, first, key=lambda lost: lost.last)
        end = bisect_right(self._open, last, key=lambda lost: lost.first)
        found = 0
        still: list[Lost] = []
        for lost in self._open[begin:end]:
            below, above = Lost(lost.first, first - 1), Lost(last + 1, lost.last)
            found += min(lost.last, last) - max(lost.first, first) + 1
            still += [part for part in (below, above) if part.first <= part.last]
        self._open[begin:end] = still
        self.late += found
        self.duplicates += last - first + 1 - found

    def _close(self, count: int) -> None:
        """Believe no more that the first ``count`` open ranges will come."""
        for lost in self._open[: max(count, 0)]:
            if len(self._closed) < MOST_RANGES:
                self._closed.append(lost)
            else:
                self._unlisted += lost.last - lost.first + 1
        del self._open[: max(count, 0)]

    def _unwrapped(self, number: int) -> int:
        """Return the number nearest to the next one that is the same modulo 2**32."""
        number %= _WRAP
        return number if not self._begun else self._next + (number - self._next + _WRAP // 2) % _WRAP - _WRAP // 2
