"""Executes the hosts of a recorded lockstep run again, without their nodes: when each step is, and what it consumes.

In lockstep the time of a step, its inputs with their order, and the reports of gaps follow from the run's messages and
its plan alone. In realtime they depend on when messages arrived, and only the journal knows that.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from dynpf_formats.recording.reader import Recorded, Recording
from dynpf_protocol.codec import encode
from dynpf_protocol.control import TickDone
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry
from dynpf_protocol.messages import Command, HostEvent
from dynpf_protocol.topics import EVENT_PREFIX

from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.gaps import GapWatch
from dynpf_runtime.inbox import LockstepInbox
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.replay import Mismatch
from dynpf_runtime.source import is_fed

__all__ = ["replay_hosts"]

_UNREAD = Command()  # inboxes do not look into messages


def replay_hosts(recording: Recording, plan: Plan) -> Iterator[Mismatch]:
    """Yield each recorded step whose time, inputs or reports of gaps are not what its host makes of the run's messages.

    A realtime run yields nothing. A run that broke off is followed as long as all nodes go on.
    """
    if plan.clock != "lockstep":
        return
    hosts = {name: _Host(recording, plan, name) for name in plan.graph.nodes}
    source = hosts[plan.graph.source]
    while (begun := source.next()) is not None:
        stamp_ns = source.stamp_ns(begun)
        for name, host in hosts.items():
            entry = begun if host is source else host.next()
            if entry is None or not host.takes(stamp_ns):
                return
            yield from host.compare(entry, stamp_ns)
            counts, sent = host.sent(entry)
            done = TickDone(name, host.boot, entry.step, entry.tick, stamp_ns, counts, entry.last)
            for other in hosts.values():
                other.hear(sent if other is not host else (), done)


class _Host:
    """The host of one node: its journal, the boot of the last entry, and its inbox."""

    def __init__(self, recording: Recording, plan: Plan, name: str) -> None:
        self.boot = ""
        self._recording, self._plan, self._name = recording, plan, name
        self._spec = plan.graph.specs[name]
        self._entries = self._journal()
        self._inbox = LockstepInbox(plan.graph, name, FaultyLink(plan.faults, name, plan.seed))
        self._gaps = GapWatch()
        self._reported: Counter[str] = Counter()
        self._inputs: list[Received] = []

    def next(self) -> JournalEntry | None:
        """Return the next journal entry, or None at the end."""
        return next(self._entries, None)

    def stamp_ns(self, entry: JournalEntry) -> int:
        """Return the time of a tick that the source begins: by the clock, or of the one record that begins it."""
        if not self._plan.plays_log:
            return entry.tick * self._plan.tick_ns
        begun = [record.stamp_ns for record in self._hosted(entry) if self._wakes(record)]
        return begun[0] if len(begun) == 1 else -1

    def takes(self, stamp_ns: int) -> bool:
        """Take the inputs of the next step; return False if one of them has not been sent."""
        ready = self._inbox.take(stamp_ns)
        self._inputs = [] if ready is None else ready.inputs
        return ready is not None

    def compare(self, entry: JournalEntry, stamp_ns: int) -> Iterator[Mismatch]:
        """Yield where an entry is not what follows from the inputs."""
        records = [record for record in self._hosted(entry) if is_fed(record)] if entry.hosted else []
        inputs = [*(_received(record) for record in records if record.topic in self._spec.reads), *self._inputs]
        reports = self._reports(inputs)
        event = EVENT_PREFIX + self._name
        for sequence, payload in reports:
            if event in self._spec.reads:
                inputs.append(Received(event, self._name, self.boot, sequence, stamp_ns, _UNREAD))
            found = self._recording.find(self._name, self.boot, event, sequence)
            if found is not None and found.payload != payload:
                yield Mismatch(self._name, event, entry.tick, sequence, "report", found.payload, payload)
        consumed = [(read.node, read.boot, read.topic, read.sequence) for read in entry.consumed]
        hosted = [(made.node, made.topic, made.sequence) for made in entry.hosted]
        # The record of a log that begins a tick is the last of the tick; others follow only at the end of the log.
        ordered = records if entry.last else sorted(records, key=self._wakes)
        own = [*((record.node, record.topic, record.sequence) for record in ordered)]
        expected = [(read.node, read.boot, read.topic, read.sequence) for read in inputs]
        pairs: tuple[tuple[str, Any, Any], ...] = (
            ("tick", entry.tick, self._inbox.tick - 1),
            ("stamp_ns", entry.stamp_ns, stamp_ns),
            ("consumed", consumed, expected),
            ("hosted", hosted, [*own, *((self._name, event, sequence) for sequence, _ in reports)]),
        )
        for field, recorded, replayed in pairs:
            if recorded != replayed:
                yield Mismatch(
                    self._name, JOURNAL_PREFIX + self._name, entry.tick, entry.step, field, recorded, replayed
                )

    def sent(self, entry: JournalEntry) -> tuple[dict[str, int], list[Received]]:
        """Return how many messages a step has sent on each topic, and those that some node may read."""
        counts: dict[str, int] = {}
        sent, awaited = [], self._plan.graph.awaited
        made = ((self._name, made.topic, made.sequence) for made in entry.produced)
        for node, topic, sequence in (*((made.node, made.topic, made.sequence) for made in entry.hosted), *made):
            record = self._recording.find(node, self.boot, topic, sequence)
            if record is not None:
                counts[topic] = counts.get(topic, 0) + 1
                if topic in awaited:
                    sent.append(Received(topic, node, self.boot, sequence, record.stamp_ns, _UNREAD))
        return counts, sent

    def hear(self, sent: Sequence[Received], done: TickDone) -> None:
        """Take what a node has sent in a step."""
        for received in sent:
            if received.topic in self._spec.reads:
                self._inbox.deliver(received, done.tick)
        self._inbox.done(done)

    def _journal(self) -> Iterator[JournalEntry]:
        for node, boot in self._recording.journals():
            if node == self._name:
                self.boot = boot
                yield from self._recording.journal(node, boot)

    def _wakes(self, record: Recorded) -> bool:
        return record.topic in self._plan.graph.waking_records

    def _hosted(self, entry: JournalEntry) -> list[Recorded]:
        found = [self._recording.find(made.node, self.boot, made.topic, made.sequence) for made in entry.hosted]
        return [record for record in found if record is not None]

    def _reports(self, inputs: Sequence[Received]) -> list[tuple[int, bytes]]:
        """Return sequence and payload of the report of each gap before these inputs."""
        noticed = [self._gaps.see(received.topic, received.node, received.sequence) for received in inputs]
        return [self._report(event) for event in noticed if event is not None]

    def _report(self, event: HostEvent) -> tuple[int, bytes]:
        sequence = self._reported[self.boot]
        self._reported[self.boot] += 1
        topic = EVENT_PREFIX + self._name
        return sequence, encode(topic, event, self._plan.graph.topics)


def _received(record: Recorded) -> Received:
    return Received(record.topic, record.node, record.boot, record.sequence, record.stamp_ns, _UNREAD)
