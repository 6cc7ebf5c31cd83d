"""What counts as "the same run": the compared messages and journals, and the content digest over them.

For each node, topic and start of the node, the digest covers the messages by sequence number: payload bytes and logical
stamp; and the steps of each journal: tick, stamp, consumed and produced messages, and the digest of the state. Only the
journal gives a message's tick. The digest leaves out boots (a node's starts are numbered in their order), publish
times, topics that are not compared, and the layout of file and journal.
"""

import hashlib
from bisect import bisect_right
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.topics import is_compared

from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.reader import Recorded, Recording
from dynpf_formats.recording.stream import Source, StreamedMessage, stream

__all__ = [
    "Chains",
    "Key",
    "Leaf",
    "StateKey",
    "StepKey",
    "StepLine",
    "content_digest",
    "leaves",
    "starts",
    "states",
    "steps",
]


class Key(NamedTuple):
    """Identifies a message; ``start`` numbers the starts of the node's process from 0."""

    node: str
    topic: str
    start: int
    sequence: int


class Leaf(NamedTuple):
    """What is compared of a message; ``tick`` is -1 if no journal has it."""

    tick: int
    stamp_ns: int
    digest: bytes  # SHA-256 of the payload
    record: Recorded


class StateKey(NamedTuple):
    """Identifies a state: the ``number``-th digest in the journal of a node's start."""

    node: str
    start: int
    number: int


class StepKey(NamedTuple):
    """Identifies a step: the ``number``-th entry in the journal of a node's start."""

    node: str
    start: int
    number: int


class StepLine(NamedTuple):
    """What is compared of a step: its messages without boots; of the produced ones only those on compared topics."""

    step: int
    tick: int
    stamp_ns: int
    consumed: tuple[tuple[str, str, int], ...]  # node, topic, sequence
    produced: tuple[tuple[str, int], ...]  # topic, sequence
    state: str


class _Chain:
    """The running digest of one source, and the next sequence number that it expects."""

    __slots__ = ("count", "digest", "expected", "missing")

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self.count = 0
        self.expected = 0
        self.missing: list[tuple[int, int]] = []  # (first, last) sequence numbers, in order

    def passed(self, sequence: int) -> bool:
        """Return whether a message with this sequence number, lower than the expected one, was added before."""
        before = bisect_right(self.missing, sequence, key=lambda gap: gap[0])
        return before == 0 or self.missing[before - 1][1] < sequence

    def add(self, sequence: int, line: tuple[Any, ...]) -> None:
        """Add the line of the message with this sequence number, which is the expected one or a higher one."""
        if sequence > self.expected:
            self.missing.append((self.expected, sequence - 1))
        self.expected = sequence + 1
        self.count += 1
        self.digest.update(_line(line))


class Chains:
    """The content digest of a recording, computed as its messages arrive.

    For each source it keeps a running SHA-256, the expected sequence number and the missing ranges. It takes the
    messages of a source in order of their sequence numbers; of repeated ones the first counts. A source with a message
    that comes after a later one is ``disordered``: ``restart`` it and add its messages again, sorted.
    """

    def __init__(self) -> None:
        self._chains: dict[Source, _Chain] = {}
        self._starts: dict[str, dict[str, int]] = {}  # node -> boot -> number, in the order in which they appear
        self.disordered: set[Source] = set()

    def add(self, source: Source, sequence: int, stamp_ns: int, payload: bytes) -> None:
        """Add the next message or journal entry; raises msgspec.DecodeError for an entry that cannot be decoded."""
        chain = self._chains.get(source)
        if chain is None:
            boots = self._starts.setdefault(source.node, {})
            boots.setdefault(source.boot, len(boots))
            chain = self._chains[source] = _Chain()
        if not _is_counted(source):
            return
        if sequence < chain.expected:
            if not chain.passed(sequence):
                self.disordered.add(source)
            return
        if source.topic.startswith(JOURNAL_PREFIX):
            chain.add(sequence, _step_line(decode_entry(payload)))
        else:
            chain.add(sequence, (sequence, stamp_ns, hashlib.sha256(payload).hexdigest()))

    def restart(self, source: Source) -> None:
        """Discard the messages of a source, which then have to be added again in order of their sequence numbers."""
        self._chains[source] = _Chain()
        self.disordered.discard(source)

    def total(self) -> str:
        """Return the SHA-256, in hexadecimal, over all sources, which are sorted by node, topic and start."""
        total = hashlib.sha256()
        lines = [
            (source.node, source.topic, self._starts[source.node][source.boot], chain.count, chain.digest.hexdigest())
            for source, chain in self._chains.items()
            if _is_counted(source)
        ]
        for line in sorted(lines):
            total.update(_line(line))
        return total.hexdigest()


def content_digest(recording: Recording) -> str:
    """Return the SHA-256, in hexadecimal, over the compared content of a recording.

    The file is read once, in bounded memory. Only sources whose messages are out of order in it are read again, by
    sequence number; all are if a channel is described after its messages.
    """
    chains = Chains()
    for item in stream(recording.path):
        if not isinstance(item, StreamedMessage):
            continue
        if item.source is None:
            return _sorted_digest(recording)
        _add(chains, recording, item.source, item)
    for source in [*chains.disordered]:
        chains.restart(source)
        for record in recording.of(source):
            _add(chains, recording, source, record)
    return chains.total()


def _sorted_digest(recording: Recording) -> str:
    chains = Chains()
    for source in recording.sources:
        for record in recording.of(source):
            _add(chains, recording, source, record)
    return chains.total()


def _add(chains: Chains, recording: Recording, source: Source, message: StreamedMessage | Recorded) -> None:
    try:
        chains.add(source, message.sequence, message.stamp_ns, message.payload)
    except msgspec.DecodeError as error:
        where = f"{recording.path}: journal of {source.node}, entry {message.sequence}"
        raise CorruptRecordingError(f"{where}: {error}") from error


def leaves(recording: Recording) -> dict[Key, Leaf]:
    """Return the compared content of every compared message."""
    numbers = starts(recording)
    found = {}
    for record in recording.messages():
        if not is_compared(record.topic):
            continue
        key = Key(record.node, record.topic, numbers[record.node, record.boot], record.sequence)
        tick = recording.tick_of(record)
        found[key] = Leaf(
            -1 if tick is None else tick, record.stamp_ns, hashlib.sha256(record.payload).digest(), record
        )
    return found


def states(recording: Recording) -> dict[StateKey, tuple[int, str]]:
    """Return (tick, state digest) of every state digest in the journals."""
    numbers = starts(recording)
    found: dict[StateKey, tuple[int, str]] = {}
    for node, boot in recording.journals():
        found.update(_states(recording, node, boot, numbers[node, boot]))
    return found


def steps(recording: Recording) -> dict[StepKey, StepLine]:
    """Return the compared content of every step."""
    numbers = starts(recording)
    return {
        StepKey(node, numbers[node, boot], number): _step_line(entry)
        for node, boot in recording.journals()
        for number, entry in enumerate(recording.journal(node, boot))
    }


def starts(recording: Recording) -> dict[tuple[str, str], int]:
    """Return the number of each (node, boot) among the starts of the node, from 0."""
    nodes = {source.node for source in recording.sources}
    return {(node, boot): start for node in nodes for start, boot in enumerate(recording.boots(node))}


def _states(recording: Recording, node: str, boot: str, start: int) -> Iterator[tuple[StateKey, tuple[int, str]]]:
    """Yield (tick, state digest) of every state in one journal, in order."""
    number = 0
    for entry in recording.journal(node, boot):
        if entry.state:
            yield StateKey(node, start, number), (entry.tick, entry.state)
            number += 1


def _is_counted(source: Source) -> bool:
    """Return whether the digest covers a source: the journal of its node, or a compared topic."""
    if source.topic.startswith(JOURNAL_PREFIX):
        return source.topic == JOURNAL_PREFIX + source.node
    return is_compared(source.topic)


def _step_line(entry: JournalEntry) -> StepLine:
    consumed = tuple([(read.node, read.topic, read.sequence) for read in entry.consumed])
    produced = tuple([(made.topic, made.sequence) for made in entry.produced if is_compared(made.topic)])
    return StepLine(entry.step, entry.tick, entry.stamp_ns, consumed, produced, entry.state)


def _line(values: tuple[Any, ...]) -> bytes:
    return msgspec.json.encode(values) + b"\n"
