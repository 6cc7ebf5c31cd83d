"""The search for the moment from which a run could not but fail, and for the cause, within a budget of futures.

With other random numbers from a tick on, a share of the futures fails. Failure is *inevitable* there if the lower end
of the share's 95 % interval (Wilson 1927) is at least ``LEVEL``, *avertable* if the upper end is below it. The share of
failing futures does not fall with the tick, so that bisection finds where one turns into the other.

What is left out is first tried with the run's own random numbers, which averts the failure or not. What averts it is
named if with other random numbers the share of failures without it is lower than with it, beyond both intervals. A
stretch of messages is then as short as it can be and still averts.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import NamedTuple

from dynpf.metrics.seeds import Proportion, proportion
from dynpf.rng import generator
from dynpf_experiments.why.causes import Cause, Event, Stretch, Way
from dynpf_experiments.why.futures import Future

__all__ = ["LEVEL", "WIDEST", "Interval", "Named", "Reasons", "Search", "Share", "Task"]

LEVEL = 0.8
WIDEST = 10
"""Ticks of the interval that is looked for, at most."""

_BATCH = 4
_MOST = 32
"""Futures by which a share is told from LEVEL, at most; one that still is near it counts as below."""

_CONFIRMING = 8
_LEAST = proportion(0, _CONFIRMING).high
"""Up to this share of failures with a cause none without it could be told from chance."""

_WINDOWS = (8, 4, 2, 1)
_MOST_CANDIDATES = 3

Ask = Callable[[Sequence[Future]], Sequence[bool]]
"""Says of each of several futures whether it fails."""


class Task(NamedTuple):
    """The tick in which a run failed, its nodes, and what can be left out of it."""

    failed: int
    nodes: Sequence[str]
    events: Sequence[Event]
    ways: Sequence[Way]


class Share(NamedTuple):
    """How many of the futures from a tick on failed."""

    tick: int
    failed: int
    trials: int

    @property
    def proportion(self) -> Proportion:
        """The share of failures with its 95 % interval."""
        return proportion(self.failed, self.trials)


class Interval(NamedTuple):
    """The ticks in which something turned: before ``first`` failure could be averted, after ``last`` no more."""

    first: int
    last: int

    @property
    def width(self) -> int:
        """The number of ticks."""
        return self.last - self.first + 1


class Named(NamedTuple):
    """A cause, when it became too late to leave it out, and the shares of failures without and with it."""

    cause: Cause
    interval: Interval
    left_out: Share
    kept: Share


class Reasons(NamedTuple):
    """What was found.

    ``shares`` are those of futures with other random numbers, by tick. ``chance`` are the ticks in which chance
    decided, None if it did not; ``by_node`` are the shares with other random numbers of one node alone, from its first
    tick on.
    """

    shares: tuple[Share, ...]
    chance: Interval | None
    by_node: tuple[tuple[str, Share], ...]
    causes: tuple[Named, ...]
    futures: int
    exhausted: bool

    @property
    def interval(self) -> Interval | None:
        """The ticks in which failure became inevitable, None if nothing that was varied averts it."""
        if self.chance is not None:
            return self.chance
        return self.causes[0].interval if self.causes else None


class _ExhaustedError(Exception):
    """The budget of futures is spent."""


class Search:
    """A search by at most ``budget`` futures, whose random numbers follow from ``seed``."""

    def __init__(self, task: Task, ask: Ask, *, budget: int, seed: int, show: Callable[[int], None]) -> None:
        self._task, self._ask, self._budget, self._seed, self._show = task, ask, budget, seed, show
        self._spent = 0
        self._seeds = self._drawn()
        self._shares: dict[int, Share] = {}
        self._chance: Interval | None = None
        self._by_node: list[tuple[str, Share]] = []
        self._causes: list[Named] = []

    def run(self) -> Reasons:
        """Search, and return what was found."""
        exhausted = False
        try:
            if not self._inevitable(1):
                self._narrow_chance()
                self._reseed_nodes()
            self._leave_out_events()
            if not self._causes:
                self._leave_out_stretches()
        except _ExhaustedError:
            exhausted = True
        shares = tuple(self._shares[tick] for tick in sorted(self._shares))
        causes = tuple(sorted(self._causes, key=lambda named: (named.left_out.proportion.rate, named.interval.width)))
        return Reasons(shares, self._chance, tuple(self._by_node), causes, self._spent, exhausted)

    def _drawn(self) -> Iterator[int]:
        """Yield seeds for futures."""
        for number in count():
            yield generator(self._seed, "why", number).integers(2**62)

    def _fail(self, futures: Sequence[Future]) -> list[bool]:
        """Return whether futures fail; raises _ExhaustedError once the budget is spent."""
        if self._spent + len(futures) > self._budget:
            raise _ExhaustedError
        self._spent += len(futures)
        self._show(self._spent)
        return list(self._ask(futures))

    def _share(self, future: Future, trials: int, known: Share | None = None) -> Share:
        """Return the share of failures of a future with as many other seeds, after those known."""
        known = known or Share(future.tick, 0, 0)
        more = self._fail([future._replace(seed=next(self._seeds)) for _ in range(trials)])
        return Share(future.tick, known.failed + sum(more), known.trials + trials)

    def _inevitable(self, tick: int) -> bool:
        """Return whether the run fails from a tick on whatever the random numbers are."""
        if tick > self._task.failed:
            return True
        share = self._shares.get(tick)
        while share is None or share.trials < _MOST:
            if share is not None and share.trials >= _BATCH:
                low, high = share.proportion[1:]
                if low >= LEVEL or high < LEVEL:
                    break
            share = self._shares[tick] = self._share(Future(tick), _BATCH, share)
        return share.proportion.low >= LEVEL

    def _narrow_chance(self) -> None:
        """Find the ticks in which failure became inevitable, whatever the random numbers are."""
        self._chance = Interval(1, self._task.failed)
        while self._chance.width > WIDEST:
            self._chance = _halved(self._chance, self._inevitable)

    def _too_late(self, event: Event, ticks: Interval) -> Interval:
        """Return the tick in which it became too late to leave out an event."""
        while ticks.width > 1:
            ticks = _halved(ticks, lambda tick: not self._averts(tick, event))
        return ticks

    def _averts(self, tick: int, cause: Cause) -> bool:
        return not self._fail([Future(tick, cause=cause)])[0]

    def _named(self, tick: int, cause: Cause, interval: Interval) -> Named | None:
        """Return a cause with its shares, None if chance explains as well that the run does not fail without it."""
        kept = self._shares.get(tick)
        if kept is None or kept.trials < _CONFIRMING:
            kept = self._shares[tick] = self._share(Future(tick), _CONFIRMING, kept)
        if kept.proportion.low <= _LEAST:
            return None
        left_out = self._share(Future(tick, cause=cause), _CONFIRMING)
        if left_out.proportion.high >= kept.proportion.low:
            return None
        return Named(cause, interval, left_out, kept)

    def _leave_out_events(self) -> None:
        """Leave out each event that comes before the failure."""
        for event in self._task.events:
            begun = min(max(1, event.tick - 1), self._task.failed)
            if event.tick > self._task.failed or not self._averts(begun, event):
                continue
            interval = self._too_late(event, Interval(begun, self._task.failed))
            named = self._named(begun, event, interval)
            self._causes += [named] if named is not None else []

    def _leave_out_stretches(self) -> None:
        """Leave out stretches of messages, long ones only if no shorter one averts the failure.

        Not where most futures with other random numbers do without.
        """
        if self._shares[1].proportion.low <= _LEAST:
            return
        for windows in _WINDOWS:
            tried = [
                Stretch(way, *ticks)
                for ticks in _windows(Interval(1, self._task.failed), windows)
                for way in self._task.ways
            ]
            failing = self._fail([Future(stretch.first, cause=stretch) for stretch in tried])
            averting = [stretch for stretch, fails in zip(tried, failing, strict=True) if not fails]
            for stretch in reversed(averting[-_MOST_CANDIDATES:]):
                shortest = self._shortened(stretch)
                ticks = Interval(shortest.first, min(shortest.last, shortest.first + WIDEST - 1))
                named = self._named(shortest.first, shortest, ticks)
                self._causes += [named] if named is not None else []
            if self._causes:
                return

    def _shortened(self, stretch: Stretch) -> Stretch:
        """Return the shortest part of a stretch that averts the failure, by halving at its end, then its beginning."""
        low, last = stretch.first, stretch.last
        while low < last:
            middle = (low + last) // 2
            if self._averts(stretch.first, stretch._replace(last=middle)):
                last = middle
            else:
                low = middle + 1
        first, high = stretch.first, last
        while first < high:
            middle = (first + high + 1) // 2
            if self._averts(middle, Stretch(stretch.way, middle, last)):
                first = middle
            else:
                high = middle - 1
        return Stretch(stretch.way, first, last)

    def _reseed_nodes(self) -> None:
        """Give each node alone other random numbers, where chance begins to decide."""
        assert self._chance is not None
        for node in self._task.nodes:
            share = self._share(Future(self._chance.first, node=node), _CONFIRMING)
            self._by_node.append((node, share))


def _windows(ticks: Interval, number: int) -> list[Interval]:
    """Return intervals of a part of the ticks each, of which each begins in the middle of the one before."""
    length = ticks.width // number
    if length < 1:
        return []
    return [Interval(begin, begin + length - 1) for begin in range(ticks.first, ticks.last + 1, (length + 1) // 2)]


def _halved(ticks: Interval, late: Callable[[int], bool]) -> Interval:
    """Return the half in which ``late`` turns true: it is false at the first of the ticks, and true after the last."""
    middle = (ticks.first + ticks.last + 1) // 2
    return Interval(ticks.first, middle - 1) if late(middle) else Interval(middle, ticks.last)
