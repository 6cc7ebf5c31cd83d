"""Roles: who may say what in a run. What a message claims is compared with the plan; its order is another matter.

Without certificates a sender is known by its boot alone, which is public: then this keeps strangers' mistakes out, and
whatever no process of the run may say, but not a forgery.
"""

from collections.abc import Mapping
from typing import TypeVar

import msgspec
from dynpf_protocol.control import Act, Beat, Stop, TickDone, decode_control
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import (
    BadMessageError,
    OrderError,
    TooLargeError,
    UnknownSenderError,
    UnknownTopicError,
)
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.keys import AGAIN, DATA, JOURNAL, SHARED, TICK, data_key, topic_of
from dynpf_protocol.recall import decode_piece
from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE, MOST_BYTES, Topic, is_record
from dynpf_protocol.topics import topic as row_of

from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.plan import Plan

__all__ = ["MOST_BYTES_OF_A_TICK", "MOST_OF_A_TICK", "Roles", "check_boot", "check_named"]

MOST_OF_A_TICK = 2**16
"""How many messages a node may send on one topic in one tick."""

MOST_BYTES_OF_A_TICK = 4 * MOST_BYTES
"""How many bytes a node may send in one tick, on all topics together."""

Named = TypeVar("Named", bound=TickDone | Beat | Stop | Act)


def check_named(arrival: Arrived, prefix: str, kind: type[Named]) -> Named:
    """Return the control message whose sender its key names after ``prefix``; raises ProtocolError."""
    said = decode_control(arrival.payload, kind)
    if said.node != arrival.key[len(prefix) :]:
        raise UnknownSenderError(f"it comes in the name of {said.node!r}; expected the sender that the key names")
    return said


def check_boot(node: str, boot: str, boots: Mapping[str, str | None]) -> None:
    """Raise UnknownSenderError unless ``boot`` is that of ``node`` in this run."""
    if boots.get(node) != boot:
        raise UnknownSenderError(f"unknown sender {node!r} with boot {boot!r}; this run's is {boots.get(node)!r}")


class Roles:
    """What each process of a run of ``plan`` may say. ``boots`` has the boot of each peer; it may change in place."""

    def __init__(self, plan: Plan, boots: Mapping[str, str]) -> None:
        graph = plan.graph
        self.topics = graph.topics
        self.source = graph.source
        self._boots = boots
        self._reads = {name: frozenset(spec.reads) for name, spec in graph.specs.items()}
        self._writes = {name: frozenset(row.name for row in spec.writes.values()) for name, spec in graph.specs.items()}
        self._may_promise = {name: writes | {EVENT_PREFIX + name} for name, writes in self._writes.items()}
        self._may_promise[self.source] |= graph.acts
        self._plays_log = plan.plays_log
        self._tick_ns = plan.tick_ns if plan.clock == "lockstep" and not plan.plays_log else None

    def promised(self, name: str, sender: str) -> bool:
        """Return whether messages of ``sender`` on the topic ``name`` belong to its steps, which their ends count.

        On shared topics a node's host speaks between steps, too, and under the same sequence numbers.
        """
        if name in SHARED:
            return False
        return name in self._may_promise[sender] or (self._plays_log and sender == self.source and is_record(name))

    def written(self, node: str) -> frozenset[str]:
        """Return the topics that a node itself writes, unlike its host."""
        return self._writes[node]

    def message(self, arrival: Arrived) -> tuple[str, str, Envelope]:
        """Return topic, sending process and envelope of a message; raises ProtocolError.

        Records of an imported log carry the boot of the source, which sends them.
        """
        name, said_by = topic_of(arrival.key)
        row = self._row(name)
        envelope = decode_envelope(arrival.attachment)
        node = envelope.node
        if node not in row.publishers:
            raise UnknownSenderError(f"unknown sender {node!r}; expected {' or '.join(sorted(row.publishers))}")
        sender = self.source if node == LOG_NODE else node
        if self._boots.get(sender) != envelope.boot:
            check_boot(node, envelope.boot, {node: self._boots.get(sender)})
        if arrival.key != data_key(name, node):
            raise UnknownSenderError(f"it comes in the name of {node!r}; its key is that of {said_by!r}")
        if len(arrival.payload) > row.most_bytes:
            raise TooLargeError(
                f"{name}: a message of {len(arrival.payload)} bytes; at most {row.most_bytes} are allowed"
            )
        if self._tick_ns is not None and self.promised(name, sender):
            self._check_stamp(envelope.tick, envelope.stamp_ns)
        return name, sender, envelope

    def again(self, arrival: Arrived) -> Arrived:
        """Return what a node says again to the recorder; raises ProtocolError if it is not its own to say."""
        node, piece = arrival.key[len(AGAIN) :], decode_piece(arrival.payload)
        key, sender = piece.key, ""
        if key.startswith(DATA):
            sender = decode_envelope(piece.attachment).node
        elif key.startswith((JOURNAL, TICK)):
            sender = key.removeprefix(JOURNAL).removeprefix(TICK)
        if node not in (sender, self.source if sender == LOG_NODE else sender):
            raise UnknownSenderError(f"{node} says again what is none of its messages: {key[:100]!r}")
        return Arrived(key, piece.payload, piece.attachment)

    def tick(self, arrival: Arrived) -> TickDone:
        """Return a node's word that it has ended a tick; raises ProtocolError."""
        done = check_named(arrival, TICK, TickDone)
        check_boot(done.node, done.boot, self._boots)
        if done.node not in self._writes:
            raise UnknownSenderError(f"{done.node!r} is no node of this run")
        if done.step != done.tick:
            raise OrderError(f"step {done.step} at tick {done.tick}; a node makes one step a tick")
        for name, count in done.counts.items():
            if name not in self._writes[done.node] and not self.promised(name, done.node):
                raise UnknownSenderError(f"{done.node} promises messages on {name!r}, which it does not write")
            if not 0 < count <= MOST_OF_A_TICK:
                raise BadMessageError(f"TickDone: {count} messages on {name}; expected 1 to {MOST_OF_A_TICK}")
        self._check_stamp(done.tick, done.stamp_ns)
        return done

    def _row(self, name: str) -> Topic:
        """Return the row of a topic of this run; raises UnknownTopicError.

        A played log may have records that no node reads, of any robots.
        """
        row = self.topics.get(name)
        if is_record(name):
            row = (row or row_of(name)) if self._plays_log else None
        if row is None:
            raise UnknownTopicError(f"topic {name!r} is not in the topic table")
        return row

    def entry(self, arrival: Arrived) -> tuple[Envelope, JournalEntry]:
        """Return a journal entry with its envelope; raises ProtocolError."""
        node = arrival.key[len(JOURNAL) :]
        envelope = decode_envelope(arrival.attachment)
        if envelope.node != node or node not in self._writes:
            raise UnknownSenderError(f"unknown sender {envelope.node!r}; expected the node that the key names")
        check_boot(node, envelope.boot, self._boots)
        topic = JOURNAL_PREFIX + node
        if len(arrival.payload) > MOST_BYTES:
            raise TooLargeError(f"{topic}: {len(arrival.payload)} bytes; at most {MOST_BYTES} are allowed")
        try:
            entry = decode_entry(arrival.payload)
        except msgspec.DecodeError as error:
            raise BadMessageError(f"{topic}: {error}") from error
        place = (entry.step, entry.tick, entry.stamp_ns)
        if place != (envelope.sequence, envelope.tick, envelope.stamp_ns) or entry.step != entry.tick:
            raise OrderError(f"step {entry.step}, tick {entry.tick} differ from its envelope's, or from each other")
        self._check_stamp(entry.tick, entry.stamp_ns)
        self._check_references(node, entry)
        return envelope, entry

    def _check_references(self, node: str, entry: JournalEntry) -> None:
        for made in entry.produced:
            if made.topic not in self._writes[node]:
                raise UnknownSenderError(f"a step of {node} has made a message on {made.topic!r}, which it never does")
        boots = {**self._boots, LOG_NODE: self._boots.get(self.source)}
        for read in entry.consumed:
            if read.topic not in self._reads[node] or boots.get(read.node) != read.boot:
                raise UnknownSenderError(
                    f"a step of {node} has read {read.topic!r} of {read.node!r}, boot {read.boot!r}; "
                    f"it does not read that, or no process of this run has sent it"
                )

    def _check_stamp(self, tick: int, stamp_ns: int) -> None:
        """By a clock the time is known; by a log it is the log's."""
        if self._tick_ns is not None and stamp_ns != tick * self._tick_ns:
            raise OrderError(f"tick {tick} at {stamp_ns} ns; expected {tick * self._tick_ns} ns")
