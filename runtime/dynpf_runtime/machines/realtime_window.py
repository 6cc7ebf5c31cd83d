"""The recorder's window in realtime: what each node's new start needs to do again what its last one has done.

What a step has read only its journal entry knows. So of each node the entries since its last snapshot are kept, and of
all messages those that a step may still read, or has read since its node's last snapshot.
"""

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import NamedTuple

from dynpf_protocol.control import TickDone
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.keys import JOURNAL
from dynpf_protocol.recall import Piece
from dynpf_protocol.snapshots import FrozenInbox
from dynpf_protocol.topics import LOG_NODE

from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.effects import Record
from dynpf_runtime.machines.offers import Offers
from dynpf_runtime.machines.window import EACH, MOST_BYTES, PART_BYTES, PART_TICKS, Part, piece_of

__all__ = ["Done", "RealtimeWindow", "done_of"]

_Place = tuple[str, str, int]
"""Node, topic and sequence of a message."""


class Done(NamedTuple):
    """The journal entry of a step, and the messages that its host has published: a log's records, reports of gaps."""

    entry: Record
    hosted: tuple[Record, ...]

    @property
    def journal(self) -> JournalEntry:
        """The decoded entry."""
        assert self.entry.entry is not None
        return self.entry.entry

    @property
    def size(self) -> int:
        """How much it takes, bytes."""
        return EACH + len(self.entry.payload) + sum(EACH + len(record.payload) for record in self.hosted)


class RealtimeWindow:
    """What is written of the steps of all nodes of a run with ``graph``."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._steps: dict[str, dict[int, Done]] = {name: {} for name in graph.nodes}
        self._messages: dict[_Place, Record] = {}  # in the order in which they were written
        self._readers: dict[str, list[str]] = {}
        for name in graph.nodes:
            for topic in graph.specs[name].reads.keys() - (graph.acts if name == graph.source else ()):
                self._readers.setdefault(topic, []).append(name)
        self._read: dict[tuple[str, str], int] = {}  # node and topic -> the number after the last that was read
        self._offers = Offers(graph.nodes)
        self.size = 0  # bytes

    def wrote(self, end: TickDone | None, messages: Iterable[Record], entry: Record | None) -> None:  # noqa: ARG002
        """Add a step that has been written."""
        messages = list(messages)
        for record in messages:
            self._add(record)
        if entry is not None and entry.entry is not None:
            name, journal = entry.envelope.node, entry.entry
            self._steps[name][journal.step] = done = done_of(entry, messages)
            self.size += done.size
            for read in journal.consumed:
                self._read[read.node, read.topic] = max(self._read.get((read.node, read.topic), 0), read.sequence + 1)
            self._offers.wrote(name, journal.tick, journal if journal.state else None)
        if self.size > MOST_BYTES:
            self._forget_oldest()

    def let_in(self, record: Record) -> None:
        """Do nothing: what a step has read its journal entry tells."""

    def found(self, record: Record, sender: str) -> None:  # noqa: ARG002
        """Add a message of a written step that has come late."""
        self._add(record)

    def offer(self, name: str, payload: bytes) -> None:
        """Take a node's snapshot, before or after its step is written."""
        snapshot = self._offers.take(name, payload)
        if snapshot is not None and (done := self._steps[name].get(snapshot.tick)) is not None:
            self._offers.wrote(name, snapshot.tick, done.journal if done.journal.state else None)

    def confirm(self, kept: Mapping[str, int]) -> None:
        """Let the snapshots count after whose steps nothing is lost: so many steps of each node are in the file."""
        if self._offers.confirm(kept):
            self._forget()

    def read_beyond(self, name: str, numbers: Mapping[str, int]) -> str:
        """Return a topic of which others have read more of a node's messages than these ``numbers``, or ""."""
        for topic, number in self._read.items():
            node = self._graph.source if topic[0] == LOG_NODE else topic[0]
            if node == name and number > numbers.get(topic[1], 0):
                return topic[1]
        return ""

    def part(self, name: str, tick: int, following: Mapping[int, Done], until: int) -> Part | None:
        """Return what a node has read and done in the steps from ``tick`` on, or as much as goes into one answer.

        ``following`` has those that are not written yet, up to step ``until``. None if a message that a step has read
        is not here; it may still come.
        """
        counting = self._offers.counting.get(name)
        if counting is not None and tick <= counting.snapshot.tick:
            return Part((), (), counting.snapshot.tick + 1, True, snapshot=counting.payload)
        pieces: list[Piece] = []
        size, first = 0, tick
        while tick < until and tick < first + PART_TICKS and size < PART_BYTES:
            done = self._steps[name].get(tick) or following.get(tick)
            if done is None:
                return Part((), (), tick, False, whole=False)
            read = self._read_by(name, done)
            if read is None:
                return None
            pieces += [piece_of(record) for record in (*done.hosted, *read)]
            pieces.append(Piece(JOURNAL + name, done.entry.payload, b""))
            size += sum(len(record.payload) for record in read) + done.size
            tick += 1
        return Part(tuple(pieces), (), tick, tick < until)

    def _read_by(self, name: str, done: Done) -> list[Record] | None:
        """Return the messages that a step has read of others, without those that the node's snapshot holds."""
        counting = self._offers.counting.get(name)
        held = () if counting is None or counting.inbox is None else counting.inbox.held
        here = {(one.node, one.topic, one.sequence) for one in held}
        here |= {(one.node, one.topic, one.sequence) for one in done.journal.hosted}
        places = [(one.node, one.topic, one.sequence) for one in done.journal.consumed]
        read = [self._messages.get(place) for place in places if place not in here]
        return [record for record in read if record is not None] if None not in read else None

    def _add(self, record: Record) -> None:
        place = record.envelope.node, record.topic, record.envelope.sequence
        if record.topic in self._readers and place not in self._messages:
            self._messages[place] = record
            self.size += EACH + len(record.payload)

    def _forget(self) -> None:
        """Forget what no node needs any more."""
        for name, steps in self._steps.items():
            for step in [step for step in steps if step <= self._offers.last(name)]:
                self.size -= steps.pop(step).size
        seen = {name: _numbers(self._offers.counting[name].inbox) for name in self._offers.counting}
        needed: dict[tuple[str, str], int] = {}
        for node, topic, sequence in list(self._messages):
            source = self._graph.source if node == LOG_NODE else node, topic
            if source not in needed:
                needed[source] = min(seen.get(reader, {}).get(source, 0) for reader in self._readers[topic])
            if sequence < needed[source]:
                self.size -= EACH + len(self._messages.pop((node, topic, sequence)).payload)

    def _forget_oldest(self) -> None:
        """Forget the oldest messages: a node that has read one since its last snapshot cannot come back."""
        for place in list(islice(self._messages, len(self._messages) // 2)):
            self.size -= EACH + len(self._messages.pop(place).payload)
        if self.size > MOST_BYTES:
            for steps in self._steps.values():
                steps.clear()
            self._messages.clear()
            self.size = 0


def done_of(entry: Record, messages: Iterable[Record]) -> Done:
    """Return a step by its entry and the messages that have come of it."""
    assert entry.entry is not None
    hosted = {(one.node, one.topic, one.sequence) for one in entry.entry.hosted}
    places = [((record.envelope.node, record.topic, record.envelope.sequence), record) for record in messages]
    return Done(entry, tuple(record for place, record in places if place in hosted))


def _numbers(inbox: FrozenInbox | None) -> dict[tuple[str, str], int]:
    """Return the next number of each sender and topic by an inbox."""
    return {} if inbox is None else {(seen.node, seen.topic): seen.next for seen in inbox.seen}
