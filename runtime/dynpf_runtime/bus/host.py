"""The host of one node on the bus: receives, decodes, calls step, numbers, encodes, journals, publishes.

All that is impure about a process is here and in ``member``; the node inside knows nothing of it.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence

import cv2
from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.journal import encode_entry
from dynpf_protocol.messages import Diagnostics, Log, LogLevel, timestamp

from dynpf.portable import rehearse
from dynpf_runtime.bus.intake import Intake, Refusal
from dynpf_runtime.bus.member import Member, StopSignal, join, say
from dynpf_runtime.bus.session import DATA, JOURNAL, TICK, Arrival
from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch, notice_gaps
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.inbox import LockstepInbox, Ready, RealtimeInbox
from dynpf_runtime.node import Node, Rehearsing
from dynpf_runtime.plan import Plan
from dynpf_runtime.rehearsal import rehearse_run
from dynpf_runtime.source import Feed, LogRecord, feed_log, feed_ticks

__all__ = ["run_node"]

AHEAD = 1000
"""How many ticks the source may run ahead of the recorder."""

REPORT_S = 1.0


def run_node(name: str, plan: Plan, endpoint: str, log: Sequence[LogRecord], stop: StopSignal) -> None:
    """Run the node ``name`` of ``plan`` on the bus, from joining to the recorder's word that the run is kept.

    Raises RunError if the run cannot go on, UsageError if this process does not fit into it.
    """
    cv2.setNumThreads(1)  # one order of evaluation, and no threads that wait for each other on few cores
    rehearse_run(plan, log)
    graph = plan.graph
    node = graph.specs[name].build()
    if plan.clock == "realtime":
        rehearse()  # in lockstep nobody minds a first step that loads what it calls
    if isinstance(node, Rehearsing):
        node.rehearse()  # as long as it takes: who has not joined yet is waited for
    with join(name, plan, endpoint, stop) as member:
        host = _Host(node, graph.specs[name], plan, member)
        host.subscribe()
        member.assemble(leads=name == graph.source)
        host.run(host.feeds(log) if name == graph.source else None)
        member.await_recorded()


class _Host:
    def __init__(self, node: Node, spec: NodeSpec, plan: Plan, member: Member) -> None:
        self._spec = spec
        self._awaited = plan.graph.awaited
        self._plan = plan
        self._graph = plan.graph
        self._member = member
        self._bus = member.bus
        self._executor = Executor(node, spec, plan.graph.topics, member.boot, plan.state_digest_ticks)
        self._intake = Intake(member.boots, plan.graph)
        self._gaps = GapWatch()
        self._realtime = plan.clock == "realtime"
        link = FaultyLink(plan.faults, spec.name, plan.seed)
        self._lockstep_inbox = LockstepInbox(plan.graph, spec.name, link)
        self._realtime_inbox = RealtimeInbox(plan.graph, spec.name, link)
        self._inbox = self._realtime_inbox if self._realtime else self._lockstep_inbox
        self._step_time_s = 0.0
        self._report_at = 0.0
        self._stamp_ns = 0

    def subscribe(self) -> None:
        name = self._spec.name
        for topic in self._graph.subscribed(name):
            self._bus.subscribe(DATA + topic)
        for upstream in self._graph.lags[name]:
            self._bus.subscribe(TICK + upstream)

    def feeds(self, log: Sequence[LogRecord]) -> Iterator[Feed]:
        if not self._plan.plays_log:
            return feed_ticks(self._plan.tick_ns, self._plan.max_ticks)
        return feed_log(
            log,
            self._graph,
            boot=self._member.boot,
            publish_ns=time.time_ns(),
            max_ticks=self._plan.max_ticks,
        )

    def run(self, feeds: Iterator[Feed] | None) -> None:
        """Step until the last tick; ``feeds`` begin the ticks where this node is the source."""
        if self._realtime:
            steps = self._follow_realtime() if feeds is None else self._lead_realtime(feeds)
        else:
            steps = self._follow_lockstep() if feeds is None else self._lead_lockstep(feeds)
        for last in steps:
            if last:
                return

    def _lead_lockstep(self, feeds: Iterator[Feed]) -> Iterator[bool]:
        for feed, due_ns in self._paced(feeds, self._plan.rate):
            while not self._member.stop_reason and (left_ns := due_ns - time.monotonic_ns()) > 0:
                self._receive(self._member.poll(left_ns * 1e-9))
            while (ready := self._lockstep_inbox.take(feed.stamp_ns)) is None:
                self._receive(self._member.poll())
            while self._member.ticks - self._member.behind("recorder") > AHEAD:
                self._receive(self._member.poll())
            yield self._lead(ready, feed)

    def _follow_lockstep(self) -> Iterator[bool]:
        while True:
            while (ready := self._lockstep_inbox.take()) is None:
                self._receive(self._member.poll())
            yield self._step(ready, ready.stamp_ns, last=ready.last)

    def _lead_realtime(self, feeds: Iterator[Feed]) -> Iterator[bool]:
        for feed, due_ns in self._paced(feeds, self._plan.rate or 1.0):
            while (left_ns := due_ns - time.monotonic_ns()) > 0 or self._bus.waiting:
                self._receive(self._member.poll(max(left_ns, 0) * 1e-9))
            yield self._lead(self._realtime_inbox.take_all(time.monotonic_ns()), feed)

    @staticmethod
    def _paced(feeds: Iterator[Feed], rate: float | None) -> Iterator[tuple[Feed, int]]:
        """Yield each feed, and when on the monotonic clock its tick shall begin, in ns; without a rate, at once."""
        began_ns = time.monotonic_ns()
        first_ns: int | None = None
        for feed in feeds:
            first_ns = feed.stamp_ns if first_ns is None else first_ns
            yield feed, began_ns if rate is None else began_ns + round((feed.stamp_ns - first_ns) / rate)

    def _follow_realtime(self) -> Iterator[bool]:
        inbox = self._realtime_inbox
        while True:
            due_ns = inbox.due_ns()
            wait_s = 0.5 if due_ns is None else max(due_ns - time.monotonic_ns(), 0) * 1e-9
            self._receive(self._member.poll(wait_s))
            if inbox.upstream_ended:
                ready: Ready | None = inbox.take_all(time.monotonic_ns())
            else:
                ready = inbox.take(time.monotonic_ns())
            if ready is not None:
                yield self._step(ready, ready.stamp_ns, last=ready.last)

    def _lead(self, ready: Ready, feed: Feed) -> bool:
        """Step as the source: the feed gives the time, and the log's records if there is a log."""
        ready.inputs[:0] = feed.inputs
        last = feed.last or bool(self._member.stop_reason)
        return self._step(ready, feed.stamp_ns, feed.sent, last=last)

    def _step(self, ready: Ready, stamp_ns: int, fed: Sequence[Sent] = (), *, last: bool) -> bool:
        """Run one step, publish what came of it, and return whether it was the last."""
        self._stamp_ns = stamp_ns
        events = notice_gaps(self._executor, self._gaps, ready, stamp_ns, time.time_ns())
        began = time.perf_counter()
        executed = self._executor.step(ready.tick, stamp_ns, ready.inputs, time.time_ns())
        self._step_time_s += time.perf_counter() - began
        last = last or executed.finished
        sent = (*fed, *events, *executed.sent)
        # What other nodes wait for goes first; what is only recorded or looked at, and the journal, follow.
        for one in sent:
            if one.topic in self._awaited:
                self._publish(one)
        counts = dict(Counter(one.topic for one in sent))
        self._report(at_once=last)  # the last before the recorder hears that this was all
        done = TickDone(self._spec.name, self._member.boot, self._executor.steps, ready.tick, stamp_ns, counts, last)
        self._bus.put(TICK + self._spec.name, encode_control(done))
        for one in sent:
            if one.topic not in self._awaited:
                self._publish(one)
        entry = self._executor.journal(ready.tick, stamp_ns, ready.inputs, executed.sent, last=last)
        envelope = Envelope(self._spec.name, self._member.boot, entry.step, ready.tick, stamp_ns, time.time_ns())
        self._bus.put(JOURNAL + self._spec.name, encode_entry(entry), encode_envelope(envelope))
        self._member.ticks = ready.tick + 1
        return last

    def _publish(self, one: Sent) -> None:
        self._bus.put(DATA + one.topic, one.payload, encode_envelope(one.envelope))

    def _receive(self, arrival: Arrival | None) -> None:
        if arrival is None:
            return
        if arrival.key.startswith(TICK):
            done = self._intake.accept_tick(arrival)
            if isinstance(done, Refusal):
                self._tell(done)
            else:
                self._inbox.done(done)
            return
        accepted = self._intake.accept(arrival)
        if not isinstance(accepted, Refusal):
            received, envelope = accepted
            self._inbox.deliver(received, envelope.tick, time.monotonic_ns())
            return
        if accepted.envelope is not None:
            self._inbox.deliver_refused(accepted.envelope.node, accepted.envelope.tick)
        self._tell(accepted)

    def _tell(self, refusal: Refusal) -> None:
        if not refusal.first_of_its_kind:
            return
        text = f"{refusal.topic}: message refused: {refusal.reason}"
        say(self._spec.name, text)
        message = Log(timestamp=timestamp(self._stamp_ns), level=LogLevel.WARNING, message=text, name=self._spec.name)
        self._publish(self._stamped("log", message))

    def _report(self, *, at_once: bool) -> None:
        now = time.monotonic()
        if at_once or now >= self._report_at:
            self._report_at = now + REPORT_S
            message = Diagnostics(
                node=self._spec.name,
                steps=self._executor.steps,
                step_time_s=self._step_time_s,
                refused=dict(self._intake.refused),
                queue=self._bus.waiting,
            )
            self._publish(self._stamped("diagnostics", message))

    def _stamped(self, topic: str, message: Diagnostics | Log) -> Sent:
        return self._executor.stamp(topic, message, self._member.ticks, self._stamp_ns, time.time_ns())
