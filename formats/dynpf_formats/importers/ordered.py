"""Puts the records of several sensors, which arrive out of order, in order of their stamps, in bounded memory."""

import heapq
from collections.abc import Iterator
from typing import NamedTuple

from dynpf_formats.importers.log import Losses, Record

__all__ = ["Reorder"]

WINDOW_NS = 2 * 10**9  # how much older than the newest record a record may be
STEP_NS = 60 * 10**9  # a stamp that leaps further than this from one record to the next is doubtful
RANKS = {"log/truth": 0, "log/odometry_pose": 1, "log/localized": 1, "log/scan": 2}  # of records of the same stamp

BACKWARDS = "records whose clock went backwards"
LEAPT = "records whose clock leapt ahead"


class _Waiting(NamedTuple):
    stamp_ns: int
    rank: int
    number: int
    records: tuple[Record, ...]


class Reorder:
    """A buffer of two seconds.

    The stamps of a bag go on as its own clock does, but for some jitter and a slow drift. A record whose stamp does not
    waits for the next one: if that agrees with it, the clock was set, and both stay; else its stamp was wrong, and it
    is left out. So is the first record of a bag that no other agrees with. A record over two seconds older than the
    newest one is left out in any case: it would break the log's order.
    """

    def __init__(self, losses: Losses) -> None:
        self._losses = losses
        self._heap: list[_Waiting] = []
        self._number = 0
        self._newest_ns = -1
        self._released_ns = -1
        self._ahead_ns: int | None = None  # how far the stamp of the last good record was ahead of its arrival
        self._agreed = False  # whether more than one record has that
        self._doubtful: tuple[tuple[Record, ...], int] | None = None

    def take(self, records: tuple[Record, ...], arrival_ns: int) -> Iterator[Record]:
        """Add a record that arrived at ``arrival_ns`` by the bag's clock; yield the records that are now in order.

        The record is the last of ``records``; those before it stay directly before it.
        """
        ahead_ns = records[-1].stamp_ns - arrival_ns
        if self._ahead_ns is None or abs(ahead_ns - self._ahead_ns) <= STEP_NS:
            self._agreed = self._ahead_ns is not None
            self._leave_out_doubtful()
        elif self._doubtful is not None and abs(ahead_ns - self._doubtful[1]) <= STEP_NS:
            if not self._agreed:
                self._forget_first()
            yield from self._put(self._doubtful[0])
            self._doubtful, self._agreed = None, True
        else:
            self._leave_out_doubtful()
            self._doubtful = records, ahead_ns
            return
        self._ahead_ns = ahead_ns
        yield from self._put(records)

    def _put(self, records: tuple[Record, ...]) -> Iterator[Record]:
        stamp_ns = records[-1].stamp_ns
        if stamp_ns < self._released_ns or stamp_ns < self._newest_ns - WINDOW_NS:
            self._leave_out(BACKWARDS, records)
            return
        self._newest_ns = max(self._newest_ns, stamp_ns)
        heapq.heappush(self._heap, _Waiting(stamp_ns, RANKS[records[-1].topic], self._number, records))
        self._number += 1
        yield from self._release(self._newest_ns - WINDOW_NS)

    def _forget_first(self) -> None:
        """Leave out the only record so far, whose stamp was wrong."""
        for waiting in self._heap:
            self._leave_out(LEAPT, waiting.records)
        self._heap.clear()
        self._newest_ns = self._released_ns = -1

    def _leave_out_doubtful(self) -> None:
        if self._doubtful is not None:
            records, ahead_ns = self._doubtful
            backwards = self._ahead_ns is not None and ahead_ns < self._ahead_ns
            self._leave_out(BACKWARDS if backwards else LEAPT, records)
            self._doubtful = None

    def _leave_out(self, reason: str, records: tuple[Record, ...]) -> None:
        record = records[-1]
        where = f"{record.topic} at {record.stamp_ns * 1e-9:.3f} s"
        self._losses.add(reason, f"{where}, after {self._newest_ns * 1e-9:.3f} s" if self._newest_ns >= 0 else where)

    def rest(self) -> Iterator[Record]:
        """Yield the remaining records at the end of the log."""
        self._leave_out_doubtful()
        yield from self._release(None)

    def _release(self, before_ns: int | None) -> Iterator[Record]:
        while self._heap and (before_ns is None or self._heap[0].stamp_ns < before_ns):
            waiting = heapq.heappop(self._heap)
            self._released_ns = waiting.stamp_ns
            yield from waiting.records
