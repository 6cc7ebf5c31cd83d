"""The inline runner: all nodes in one process, without a bus, as fast as the processor goes (lockstep only)."""

from collections import Counter
from collections.abc import Callable, Sequence

import cv2

from protocol.codec import decode
from protocol.control import TickDone
from protocol.envelope import Envelope
from protocol.journal import encode_entry
from services.executor import Executor, Sent
from services.faults import FaultyLink
from services.gaps import GapWatch, notice_gaps
from services.graph import Graph
from services.inbox import LockstepInbox, Ready
from services.node import Node, Received
from services.nodes import build_nodes
from services.progress import Progress
from services.recording.writer import RecordingWriter
from services.scenario import Scenario
from services.source import LogRecord, feed_log, feed_ticks

__all__ = ["BOOT", "run_inline"]

BOOT = "inline"


def run_inline(
    scenario: Scenario,
    log: Sequence[LogRecord],
    writer: RecordingWriter,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Run ``scenario`` to its end into ``writer`` and return the number of ticks.

    The messages, their order and every state are those of the same scenario and seed on the bus. ``stopped`` is asked
    before each tick whether it shall be the last.
    """
    cv2.setNumThreads(1)
    nodes = build_nodes(scenario)
    graph = Graph.of(list(nodes.values()))
    seats = {name: _Seat(nodes[name], graph, scenario) for name in graph.nodes}
    source = seats[graph.source]
    feeds = (
        feed_log(
            log,
            node=graph.source,
            boot=BOOT,
            reads=nodes[graph.source].reads,
            publish_ns=0,
            max_ticks=scenario.max_ticks,
        )
        if scenario.needs_log
        else feed_ticks(scenario.tick_ns, scenario.max_ticks)
    )

    def run(seat: _Seat, ready: Ready, stamp_ns: int, fed: Sequence[Sent] = (), *, last: bool) -> bool:
        done, sent, journal = seat.step(ready, stamp_ns, fed, last=last)
        for one in sent:
            writer.message(one.topic, one.envelope, one.payload)
            for other in seats.values():
                other.deliver(one)
        envelope = Envelope(done.node, BOOT, done.step, done.tick, stamp_ns, 0)
        writer.journal(envelope, journal)
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
        progress.show(ticks, writer.messages)
        if last:
            break
    progress.clear()
    return ticks


class _Seat:
    """One node's place: its inbox and its executor."""

    def __init__(self, node: Node, graph: Graph, scenario: Scenario) -> None:
        self._node = node
        self._executor = Executor(node, BOOT, scenario.state_digest_ticks)
        self._gaps = GapWatch()
        link = FaultyLink(scenario.faults, node.name, scenario.seed)
        self.inbox = LockstepInbox(graph, node.name, node.reads, link)

    def deliver(self, one: Sent) -> None:
        place = one.envelope
        if one.topic in self._node.reads and place.node != self._node.name:
            message = decode(one.topic, one.payload)
            received = Received(one.topic, place.node, place.boot, place.sequence, place.stamp_ns, message)
            self.inbox.deliver(received, place.tick)

    def take(self, stamp_ns: int = 0) -> Ready:
        ready = self.inbox.take(stamp_ns)
        assert ready is not None, f"{self._node.name} lacks an input of tick {self.inbox.tick}"
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
        done = TickDone(self._node.name, BOOT, entry.step, ready.tick, stamp_ns, counts, entry.last)
        return done, sent, encode_entry(entry)
