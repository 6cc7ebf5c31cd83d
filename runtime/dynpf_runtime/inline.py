"""The inline runner: all nodes in one process, without a bus, as fast as possible (lockstep only).

With a sink the run becomes a recording. Without one nothing is encoded; an observer gets the nodes' messages.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple, Protocol

import cv2
from dynpf_protocol.control import Outcome, TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import encode_entry

from dynpf_runtime.executor import Sent, Unsent
from dynpf_runtime.inbox import Ready
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.progress import Progress
from dynpf_runtime.seat import Seat
from dynpf_runtime.source import Feed, LogRecord, feed_log, feed_ticks

__all__ = ["BOOT", "Begun", "Observer", "Ran", "Sink", "run_inline"]

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


class Begun(NamedTuple):
    """A run after some ticks: its nodes' seats, whose inboxes have what they are yet to consume of the last one."""

    ticks: int
    seats: dict[str, Seat]


def run_inline(
    plan: Plan,
    log: Iterable[LogRecord],
    sink: Sink | None = None,
    *,
    observe: Observer | None = None,
    stopped: Callable[[], bool] = lambda: False,
    begun: Begun | None = None,
    acts: Mapping[int, Sequence[LogRecord]] = {},
) -> Ran:
    """Run ``plan`` to its end and return how many ticks it had, and why it ended.

    The messages, their order and every state equal those of the same plan on the bus. ``sink`` gets the encoded
    messages and the journal; without it nothing is encoded or journalled. A tick before which ``stopped`` returns true
    is the last. With ``begun`` the run goes on instead of beginning. ``acts`` has what a person does, by tick.
    """
    cv2.setNumThreads(1)
    graph = plan.graph
    begun = begun or Begun(0, {name: Seat(spec, plan, BOOT) for name, spec in graph.specs.items()})
    run = _Run(begun.seats, sink, observe)
    source = run.seats[graph.source]
    progress = Progress(plan.max_ticks)
    ticks, outcome = begun.ticks, Outcome.BUDGET
    for feed in islice(_feeds(plan, log, source.boot), begun.ticks, None):
        ready = source.take(feed.stamp_ns)
        fed, read = source.let_in(acts.get(ready.tick, ()), ready.tick, feed.stamp_ns)
        inputs = [*read, *feed.inputs, *ready.inputs]
        asked = stopped()
        last = feed.last or asked
        done = run.step(source, ready._replace(inputs=inputs), feed.stamp_ns, (*fed, *feed.sent), last=last)
        for name in graph.nodes[1:]:
            ready = run.seats[name].take()
            run.step(run.seats[name], ready, ready.stamp_ns, last=ready.last)
        ticks += 1
        if sink is not None:
            progress.show(ticks, sink.messages)
        if done.last:
            outcome = done.outcome or (Outcome.STOPPED if asked and not feed.last else Outcome.BUDGET)
            break
    progress.clear()
    return Ran(ticks, outcome)


def _feeds(plan: Plan, log: Iterable[LogRecord], boot: str) -> Iterator[Feed]:
    """Return the feeds that begin the ticks: of the clock, or of the log."""
    if not plan.plays_log:
        return feed_ticks(plan.tick_ns, plan.max_ticks)
    return feed_log(log, plan.graph, boot=boot, publish_ns=0, max_ticks=plan.max_ticks)


class _Run:
    """The seats of a run, and the receivers of its messages."""

    def __init__(self, seats: dict[str, Seat], sink: Sink | None, observe: Observer | None) -> None:
        self.seats = seats
        self._sink, self._observe = sink, observe
        self._topics = next(iter(seats.values())).topics
        topics = {topic for seat in seats.values() for topic in seat.reads}
        self._readers = {topic: [seat for seat in seats.values() if topic in seat.reads] for topic in topics}

    def step(self, seat: Seat, ready: Ready, stamp_ns: int, fed: Sequence[Sent] = (), *, last: bool) -> TickDone:
        """Run a node's step, deliver its messages, and return what it has done."""
        if self._sink is None:
            done, sent = seat.step_unsent(ready, stamp_ns, fed, last=last)
        else:
            done, sent, entry, snapshot = seat.step(ready, stamp_ns, fed, last=last)
            for encoded in sent:
                self._sink.message(*encoded)
            self._sink.journal(Envelope(done.node, done.boot, done.step, done.tick, stamp_ns, 0), encode_entry(entry))
            if snapshot is not None:
                self._sink.message(*snapshot)
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
