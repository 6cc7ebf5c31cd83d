"""Puts the records of several sensors, which arrive out of order, in order of their stamps, in bounded memory."""

import heapq
from collections.abc import Iterator
from typing import NamedTuple

from dynpf_formats.importers.log import Losses, Record

__all__ = ["Reorder"]

WINDOW_NS = 2 * 10**9  # how much older than the newest record a record may be
AHEAD_NS = 60 * 10**9  # a stamp that leaps further ahead than this, beyond the time passed meanwhile, is wrong
RANKS = {"log/truth": 0, "log/odometry_pose": 1, "log/scan": 2}  # of records of the same stamp

BACKWARDS = "records whose clock went backwards"
LEAPT = "records whose clock leapt ahead"


class _Waiting(NamedTuple):
    stamp_ns: int
    rank: int
    number: int
    records: tuple[Record, ...]


class Reorder:
    """A buffer of two seconds.

    A record over two seconds older than the newest one is left out, as is one whose stamp leaps ahead of the bag's own
    clock by over a minute: each would break the log's order.
    """

    def __init__(self, losses: Losses) -> None:
        self._losses = losses
        self._heap: list[_Waiting] = []
        self._number = 0
        self._newest_ns: int | None = None
        self._arrival_ns = 0
        self._released_ns = -1

    def take(self, records: tuple[Record, ...], arrival_ns: int) -> Iterator[Record]:
        """Add a record that arrived at ``arrival_ns`` by the bag's clock; yield the records that are now in order.

        The record is the last of ``records``; those before it stay directly before it.
        """
        record = records[-1]
        stamp_ns = record.stamp_ns
        where = f"{record.topic} at {stamp_ns * 1e-9:.3f} s"
        if self._newest_ns is not None:
            passed = max(arrival_ns - self._arrival_ns, 0)
            if stamp_ns - self._newest_ns > passed + AHEAD_NS:
                self._losses.add(LEAPT, f"{where}, after {self._newest_ns * 1e-9:.3f} s")
                return
            if stamp_ns < self._released_ns or stamp_ns < self._newest_ns - WINDOW_NS:
                self._losses.add(BACKWARDS, f"{where}, after {self._newest_ns * 1e-9:.3f} s")
                return
        if self._newest_ns is None or stamp_ns >= self._newest_ns:
            self._newest_ns, self._arrival_ns = stamp_ns, arrival_ns
        heapq.heappush(self._heap, _Waiting(stamp_ns, RANKS[record.topic], self._number, records))
        self._number += 1
        yield from self._release(self._newest_ns - WINDOW_NS)

    def rest(self) -> Iterator[Record]:
        """Yield the remaining records at the end of the log."""
        yield from self._release(None)

    def _release(self, before_ns: int | None) -> Iterator[Record]:
        while self._heap and (before_ns is None or self._heap[0].stamp_ns < before_ns):
            waiting = heapq.heappop(self._heap)
            self._released_ns = waiting.stamp_ns
            yield from waiting.records
