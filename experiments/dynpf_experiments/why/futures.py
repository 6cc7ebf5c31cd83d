"""Futures of a recorded run: branched at a tick, with other random numbers or without a cause, and looked at."""

import multiprocessing
import signal
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from multiprocessing.pool import Pool
from typing import NamedTuple

from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import StepError, UsageError
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.topics import LOG_NODE
from dynpf_runtime.branch import Past
from dynpf_runtime.faults import LeftOut
from dynpf_runtime.graph import Graph
from dynpf_runtime.inline import Begun, run_inline
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.source import LogRecord
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import acts_of, log_records
from dynpf_services.scenario.schema import Scenario

from dynpf_experiments.why.causes import Cause, Event, Stretch, without
from dynpf_experiments.why.condition import Condition, Value
from dynpf_experiments.why.quantities import Quantities, Watch

__all__ = ["Failure", "Future", "Trunk", "many"]


class Future(NamedTuple):
    """A branch of a run at a tick.

    ``seed`` is that of all random streams from there on, or of those of one ``node``; None: the run's own. ``cause`` is
    left out from there on.
    """

    tick: int
    seed: int | None = None
    node: str = ""
    cause: Cause | None = None


class Failure(NamedTuple):
    """The first tick in which the condition holds, its logical time, and the values that it has there."""

    tick: int
    stamp_ns: int
    values: Mapping[str, Value]


class Trunk:
    """A recorded run as far as its failure, from which futures branch.

    A future fails if the condition holds in it, from its first tick until ``within`` ticks after the run's failure, or
    if one of its nodes breaks off. Raises UsageError for a realtime run, and if the condition never holds.
    """

    def __init__(
        self, recording: Recording, scenario: Scenario, condition: Condition, quantities: Quantities, within: int
    ) -> None:
        if scenario.clock != "lockstep":
            raise UsageError(
                "a realtime run cannot go on from its middle: only futures of a lockstep run can be looked at"
            )
        self._recording, self._scenario = recording, scenario
        self._condition, self._quantities = condition, quantities
        # The journals are chained from the text that was recorded.
        self.plan = plan_of(scenario)._replace(text=recording.header.scenario)
        self._stamps_ns = self._steps()
        self._snapshots: dict[int, dict[str, Snapshot]] = {}
        self._newest: list[dict[str, Received]] = []  # of the topics that the condition needs, before each tick
        self.failure = self._failure()
        last = min(self.failure.tick + within, len(self._stamps_ns) - 1)
        self._horizon_ns = self._stamps_ns[last]

    @cached_property
    def _log(self) -> Sequence[LogRecord]:
        return log_records(self._recording)

    @cached_property
    def _acts(self) -> dict[int, list[LogRecord]]:
        return acts_of(self._recording)

    @cached_property
    def _records(self) -> list[list[int]]:
        """The indices of the log's records that each tick plays."""
        numbers: dict[tuple[str, int], int] = {}
        counts: dict[str, int] = {}
        for index, record in enumerate(self._log):
            numbers[record.topic, counts.setdefault(record.topic, 0)] = index
            counts[record.topic] += 1
        return [
            [numbers[made.topic, made.sequence] for made in entry.hosted if made.node == LOG_NODE]
            for entry in self._recording.journal(*self._source)
        ]

    @cached_property
    def _source(self) -> tuple[str, str]:
        boots = [pair for pair in self._recording.journals() if pair[0] == self.plan.graph.source]
        if len(boots) != 1:
            raise UsageError(
                f"{self._recording.path}: has {len(boots)} journals of {self.plan.graph.source}; expected one"
            )
        return boots[0]

    def _steps(self) -> list[int]:
        stamps = [entry.stamp_ns for entry in self._recording.journal(*self._source)]
        if len(stamps) < 2:
            raise UsageError(f"{self._recording.path}: the run has {len(stamps)} ticks: nothing to branch")
        return stamps

    def seconds(self, tick: int) -> float:
        """Return the time of a tick, s since the run's first."""
        return (self._stamps_ns[min(tick, len(self._stamps_ns) - 1)] - self._stamps_ns[0]) * 1e-9

    def _failure(self) -> Failure:
        """Do the run again up to its failure."""
        watch = Watch(self._condition, self._quantities)
        ticks = 0

        def looked() -> bool:
            """Look at the tick that has ended, and return whether the next is the last."""
            nonlocal ticks
            failed = ticks > 0 and watch.look(ticks - 1)
            self._newest.append(dict(watch.newest))
            ticks += 1
            return failed

        plan = self.plan._replace(max_ticks=len(self._stamps_ns))
        run_inline(plan, self._log, observe=watch, stopped=looked, acts=self._acts)
        watch.look(ticks - 1)
        if watch.failed is None:
            seen = ", ".join(f"{name} was {low:.4g} to {high:.4g}" for name, (low, high) in watch.extremes.items())
            raise UsageError(
                f"{self._recording.path}: the condition holds in none of {len(self._stamps_ns)} ticks"
                + (f": {seen}" if seen else "; nothing that it names was ever known")
            )
        if watch.failed == 0:
            raise UsageError(
                f"{self._recording.path}: the condition holds in the first tick; say from when on, such as "
                "(CONDITION) and time > 5"
            )
        return Failure(watch.failed, self._stamps_ns[watch.failed], watch.values)

    def fails(self, future: Future) -> bool:
        """Return whether a future fails; raises RunError if the nodes do not do again what they did before it."""
        past = Past(self._recording, self.plan, future.tick)
        plan, others = self._plan(future)
        seats, _ = past.seats(self._brought(past, future.tick), plan, others)
        watch = Watch(self._condition, self._quantities)
        for received in self._newest[future.tick].values():
            watch(received)
        ticks = future.tick

        def looked() -> bool:
            """Look at the tick that has ended, and return whether the next is the last."""
            nonlocal ticks
            failed = ticks > future.tick and watch.look(ticks - 1)
            ticks += 1
            return failed or watch.stamp_ns >= self._horizon_ns

        log = self._log if self.plan.plays_log else ()
        try:
            left, begun = self._left(future, log), Begun(future.tick, seats)
            run_inline(plan, left, observe=watch, stopped=looked, begun=begun, acts=self._acts)
        except StepError:
            return True
        watch.look(ticks - 1)
        return watch.failed is not None

    def _brought(self, past: Past, tick: int) -> dict[str, Snapshot]:
        """Return the snapshots of all nodes before a tick."""
        if tick not in self._snapshots:
            earlier = max((known for known in self._snapshots if known < tick), default=None)
            before = {} if earlier is None else self._snapshots[earlier]
            self._snapshots[tick] = {name: past.freeze(name, before.get(name)) for name in self.plan.graph.nodes}
        return self._snapshots[tick]

    def _plan(self, future: Future) -> tuple[Plan, tuple[str, ...]]:
        """Return the plan of a future, and the nodes with other settings."""
        scenario = self._scenario
        others: tuple[str, ...] = ()
        if isinstance(future.cause, Event):
            scenario = without(scenario, future.cause)
            others = tuple(filter(None, (future.cause.node,)))
        plan = plan_of(scenario if future.seed is None or future.node else scenario.changed(seed=future.seed))
        if future.node and future.seed is not None:
            reseeded = plan_of(scenario.changed(seed=future.seed)).graph.specs[future.node]
            specs = [reseeded if spec.name == future.node else spec for spec in plan.graph.specs.values()]
            plan = plan._replace(graph=Graph(specs))
        if isinstance(future.cause, Stretch) and not self.plan.plays_log:
            plan = plan._replace(left_out=tuple(self._lost(future.cause)))
        return plan, others

    def _lost(self, stretch: Stretch) -> Iterator[LeftOut]:
        first, after = self._stamps_ns[stretch.first], stretch.last + 1
        end = self._stamps_ns[after] if after < len(self._stamps_ns) else self._stamps_ns[-1] + 1
        for node in stretch.way.to:
            yield LeftOut(stretch.way.topic, node, first, end)

    def _left(self, future: Future, log: Sequence[LogRecord]) -> Iterable[LogRecord]:
        """Return the records of a log without those of a stretch; what is left is what later ticks play."""
        if not isinstance(future.cause, Stretch) or not self.plan.plays_log:
            return log
        stretch = future.cause
        ticks = self._records[stretch.first : stretch.last + 1]
        lost = {index for tick in ticks for index in tick if log[index].topic == stretch.way.topic}
        return [record for index, record in enumerate(log) if index not in lost]


@contextmanager
def many(trunk: Trunk, jobs: int) -> Iterator["_Ask"]:
    """Have a function that says of each of several futures whether it fails, by as many processes."""
    if jobs == 1:
        yield _Ask(trunk, None)
        return
    context = multiprocessing.get_context("fork")
    with context.Pool(jobs, _Worker.begin, (trunk,)) as pool:
        yield _Ask(trunk, pool)


class _Ask:
    """Carries futures out, in this process or in a pool."""

    def __init__(self, trunk: Trunk, pool: Pool | None) -> None:
        self._trunk, self._pool = trunk, pool

    def __call__(self, futures: Sequence[Future]) -> list[bool]:
        """Return whether each fails."""
        if self._pool is None:
            return [self._trunk.fails(future) for future in futures]
        return self._pool.map(_Worker.fails, futures, 1)


class _Worker:
    """The trunk that a worker process has inherited by the fork."""

    trunk: Trunk

    @classmethod
    def begin(cls, trunk: Trunk) -> None:
        """Take the trunk; who interrupts the command ends the pool, and no worker says so, too."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        cls.trunk = trunk

    @classmethod
    def fails(cls, future: Future) -> bool:
        """Return whether a future fails."""
        return cls.trunk.fails(future)
