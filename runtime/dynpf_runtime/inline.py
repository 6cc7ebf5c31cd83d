"""The inline runner: all nodes in one process, without a bus, as fast as possible (lockstep only).

With a sink the run becomes a recording. Without one nothing is encoded; an observer gets the nodes' messages.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, Protocol

import cv2
from dynpf_protocol.control import Outcome, TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import encode_entry, genesis

from dynpf_runtime.executor import Executor, Sent, Unsent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.inbox import LockstepInbox, Ready
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.progress import Progress
from dynpf_runtime.source import Feed, LogRecord, feed_log, feed_ticks

__all__ = ["BOOT", "Observer", "Ran", "Sink", "run_inline"]

BOOT = "inline"

Observer = Callable[[Received], None]
"""Called with each message of a run, in the order of sending."""


class Sink(Protocol):
    """Where a run is written, such as a RecordingWriter."""

    @property
    def messages(self) -> int:
        """Number of messages so far."""

    def message(self, topic: str, envelope: Envelope, payload: bytes) -> None:
        """Write a message."""

    def journal(self, envelope: Envelope, payload: bytes) -> None:
        """Write a journal entry."""


class Ran(NamedTuple):
    """How many ticks a run had, and why the last one was the last."""

    ticks: int
    outcome: Outcome


def run_inline(
    plan: Plan,
    log: Iterable[LogRecord],
    sink: Sink | None = None,
    *,
    observe: Observer | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Ran:
    """Run ``plan`` to its end and return how many ticks it had, and why it ended.

    The messages, their order and every state equal those of the same plan on the bus. ``sink`` gets the encoded
    messages and the journal; without it nothing is encoded or journalled. A tick before which ``stopped`` returns true
    is the last.
    """
    cv2.setNumThreads(1)
    graph = plan.graph
    run = _Run({name: _Seat(spec, plan) for name, spec in graph.specs.items()}, sink, observe)
    source = run.seats[graph.source]
    progress = Progress()
    ticks, outcome = 0, Outcome.BUDGET
    for feed in _feeds(plan, log):
        ready = source.take(feed.stamp_ns)
        inputs = [*feed.inputs, *ready.inputs]
        asked = stopped()
        last = feed.last or asked
        done = run.step(source, ready._replace(inputs=inputs), feed.stamp_ns, feed.sent, last=last)
        for name in graph.nodes[1:]:
            ready = run.seats[name].take()
            run.step(run.seats[name], ready, ready.stamp_ns, last=ready.last)
        ticks += 1
        if sink is not None:
            progress.show(ticks, sink.messages)
        if done.last:
            outcome = done.outcome or (Outcome.STOPPED if asked else Outcome.BUDGET)
            break
    progress.clear()
    return Ran(ticks, outcome)


def _feeds(plan: Plan, log: Iterable[LogRecord]) -> Iterator[Feed]:
    """Return the feeds that begin the ticks: of the clock, or of the log."""
    if not plan.plays_log:
        return feed_ticks(plan.tick_ns, plan.max_ticks)
    return feed_log(log, plan.graph, boot=BOOT, publish_ns=0, max_ticks=plan.max_ticks)


class _Run:
    """The seats of a run, and the receivers of its messages."""

    def __init__(self, seats: "dict[str, _Seat]", sink: Sink | None, observe: Observer | None) -> None:
        self.seats = seats
        self._sink, self._observe = sink, observe
        self._topics = next(iter(seats.values())).topics
        topics = {topic for seat in seats.values() for topic in seat.reads}
        self._readers = {topic: [seat for seat in seats.values() if topic in seat.reads] for topic in topics}

    def step(self, seat: "_Seat", ready: Ready, stamp_ns: int, fed: Sequence[Sent] = (), *, last: bool) -> TickDone:
        """Run a node's step, deliver its messages, and return what it has done."""
        if self._sink is None:
            done, sent = seat.step_unsent(ready, stamp_ns, fed, last=last)
        else:
            done, sent, journal = seat.step(ready, stamp_ns, fed, last=last)
            for encoded in sent:
                self._sink.message(*encoded)
            self._sink.journal(Envelope(done.node, BOOT, done.step, done.tick, stamp_ns, 0), journal)
        for message in sent:
            self._deliver(message)
        for other in self.seats.values():
            other.inbox.done(done)
        return done

    def _deliver(self, sent: Sent | Unsent) -> None:
        topic, envelope = sent.topic, sent.envelope
        readers = self._readers.get(topic, ())
        if not readers and self._observe is None:
            return
        node = envelope.node
        received = Received(
            topic, node, envelope.boot, envelope.sequence, envelope.stamp_ns, sent.message(self._topics)
        )
        for seat in readers:
            if seat.name != node:
                seat.inbox.deliver(received, envelope.tick)
        if self._observe is not None:
            self._observe(received)


class _Seat:
    """One node with its inbox and its executor."""

    def __init__(self, spec: NodeSpec, plan: Plan) -> None:
        self.name, self.reads = spec.name, spec.reads
        self.topics = plan.graph.topics
        chain = genesis(spec.name, plan.text)
        self._executor = Executor(spec.build(), spec, self.topics, BOOT, plan.state_digest_ticks, chain=chain)
        self._gaps = GapWatch()
        self.inbox = LockstepInbox(plan.graph, spec.name, FaultyLink(plan.faults, spec.name, plan.seed))

    def take(self, stamp_ns: int = 0) -> Ready:
        """Return the next step's inputs, which are complete at the node's turn in the tick."""
        ready = self.inbox.take(stamp_ns)
        assert ready is not None, f"{self.name} lacks an input of tick {self.inbox.tick}"
        return ready

    def step(
        self, ready: Ready, stamp_ns: int, fed: Sequence[Sent], *, last: bool
    ) -> tuple[TickDone, tuple[Sent, ...], bytes]:
        """Run a step; return its TickDone, the messages, and the encoded journal entry."""
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, 0)
        executed = self._executor.step(ready.tick, stamp_ns, ready.inputs, 0)
        finished = executed.finished
        last = last or finished
        hosted = (*fed, *events)
        entry = self._executor.journal(ready.tick, stamp_ns, ready.inputs, executed.sent, hosted=hosted, last=last)
        sent = (*hosted, *executed.sent)
        return self._done(ready.tick, stamp_ns, sent, last=last, finished=finished), sent, encode_entry(entry)

    def step_unsent(
        self, ready: Ready, stamp_ns: int, fed: Sequence[Sent], *, last: bool
    ) -> tuple[TickDone, tuple[Sent | Unsent, ...]]:
        """Run a step without a journal entry; return its TickDone and the messages."""
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, 0)
        results, finished = self._executor.step_unsent(ready.tick, stamp_ns, ready.inputs)
        sent: tuple[Sent | Unsent, ...] = (*fed, *events, *results)
        return self._done(ready.tick, stamp_ns, sent, last=last or finished, finished=finished), sent

    def _done(self, tick: int, stamp_ns: int, sent: Sequence[Sent | Unsent], *, last: bool, finished: bool) -> TickDone:
        counts = dict(Counter(message.topic for message in sent))
        outcome = Outcome.DONE if finished else None
        return TickDone(self.name, BOOT, self._executor.steps - 1, tick, stamp_ns, counts, last, outcome)
