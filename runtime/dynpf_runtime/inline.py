"""The inline runner: all nodes in one process, without a bus, as fast as the processor goes (lockstep only)."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Protocol

import cv2
from dynpf_protocol.codec import decode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import encode_entry

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.inbox import LockstepInbox, Ready
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.progress import Progress
from dynpf_runtime.source import LogRecord, feed_log, feed_ticks

__all__ = ["BOOT", "Sink", "run_inline"]

BOOT = "inline"


class Sink(Protocol):
    """Where a run goes: into a recording, or nowhere."""

    @property
    def messages(self) -> int: ...

    def message(self, topic: str, envelope: Envelope, payload: bytes) -> None: ...

    def journal(self, envelope: Envelope, payload: bytes) -> None: ...


def run_inline(
    plan: Plan,
    log: Sequence[LogRecord],
    sink: Sink,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Run ``plan`` to its end into ``sink`` and return the number of ticks.

    The messages, their order and every state are those of the same plan on the bus. ``stopped`` is asked
    before each tick whether it shall be the last.
    """
    cv2.setNumThreads(1)
    graph = plan.graph
    seats = {name: _Seat(spec, plan) for name, spec in graph.specs.items()}
    source = seats[graph.source]
    feeds = (
        feed_log(log, graph, boot=BOOT, publish_ns=0, max_ticks=plan.max_ticks)
        if plan.plays_log
        else feed_ticks(plan.tick_ns, plan.max_ticks)
    )

    def run(seat: _Seat, ready: Ready, stamp_ns: int, fed: Sequence[Sent] = (), *, last: bool) -> bool:
        done, sent, journal = seat.step(ready, stamp_ns, fed, last=last)
        for one in sent:
            sink.message(one.topic, one.envelope, one.payload)
            for other in seats.values():
                other.deliver(one)
        envelope = Envelope(done.node, BOOT, done.step, done.tick, stamp_ns, 0)
        sink.journal(envelope, journal)
        for other in seats.values():
            other.inbox.done(done)
        return done.last

    ticks = 0
    progress = Progress()
    for feed in feeds:
        ready = source.take(feed.stamp_ns)
        inputs = [*feed.inputs, *ready.inputs]
        last = run(source, ready._replace(inputs=inputs), feed.stamp_ns, feed.sent, last=feed.last or stopped())
        for name in graph.nodes[1:]:
            ready = seats[name].take()
            run(seats[name], ready, ready.stamp_ns, last=ready.last)
        ticks += 1
        progress.show(ticks, sink.messages)
        if last:
            break
    progress.clear()
    return ticks


class _Seat:
    """One node's place: its inbox and its executor."""

    def __init__(self, spec: NodeSpec, plan: Plan) -> None:
        self._spec = spec
        self._topics = plan.graph.topics
        self._executor = Executor(spec.build(), spec, self._topics, BOOT, plan.state_digest_ticks)
        self._gaps = GapWatch()
        self.inbox = LockstepInbox(plan.graph, spec.name, FaultyLink(plan.faults, spec.name, plan.seed))

    def deliver(self, one: Sent) -> None:
        place = one.envelope
        if one.topic in self._spec.reads and place.node != self._spec.name:
            message = decode(one.topic, one.payload, self._topics)
            received = Received(one.topic, place.node, place.boot, place.sequence, place.stamp_ns, message)
            self.inbox.deliver(received, place.tick)

    def take(self, stamp_ns: int = 0) -> Ready:
        ready = self.inbox.take(stamp_ns)
        assert ready is not None, f"{self._spec.name} lacks an input of tick {self.inbox.tick}"
        return ready

    def step(
        self, ready: Ready, stamp_ns: int, fed: Sequence[Sent], *, last: bool
    ) -> tuple[TickDone, tuple[Sent, ...], bytes]:
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, 0)
        executed = self._executor.step(ready.tick, stamp_ns, ready.inputs, 0)
        last = last or executed.finished
        entry = self._executor.journal(ready.tick, stamp_ns, ready.inputs, executed.sent, last=last)
        sent = (*fed, *events, *executed.sent)
        counts = dict(Counter(one.topic for one in sent))
        done = TickDone(self._spec.name, BOOT, entry.step, ready.tick, stamp_ns, counts, entry.last)
        return done, sent, encode_entry(entry)
