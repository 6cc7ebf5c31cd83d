"""Reads a part of a recording: by the index at its end only the chunks that are needed, each with its checksum.

What is not read is not checked: that nothing is missing or put in elsewhere, and the seal of the whole, are told by
``read_recording`` and ``dynpf doctor``.
"""

import os
from collections import OrderedDict
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

import msgspec
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.restoring import agreed, decode_snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX

from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.header import RUN_END, Attachment, RunEnd, RunHeader, from_entries
from dynpf_formats.recording.index import MessageIndex
from dynpf_formats.recording.mcap_records import MAX_RATIO, MAX_UNPACKED, Message, Region, contents
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.stream import RecordedSchema, Source, StreamedMessage, stream
from dynpf_formats.recording.summary import Summary, read_chunk, read_metadata, read_summary
from dynpf_formats.regular_files import open_regular

__all__ = ["Indexed", "Moment", "NoIndexError", "Origin", "chunk_at", "origins"]

_KEPT = 16  # chunks
_TRIES = 4  # snapshots that are tried, if the last ones do not agree with the journal


class NoIndexError(RecordingError):
    """A part of the file cannot be found by its index, or is not as the index says: it has to be read as a whole."""


class Moment(NamedTuple):
    """A moment of a run: a tick, or a logical time in nanoseconds; ``value`` counts in one of them."""

    unit: str  # "tick" or "ns"
    value: int

    def after(self, entry: JournalEntry) -> bool:
        """Return whether the moment is after a step."""
        return (entry.tick if self.unit == "tick" else entry.stamp_ns) < self.value

    def before(self, entry: JournalEntry) -> bool:
        """Return whether the moment is before a step."""
        return (entry.tick if self.unit == "tick" else entry.stamp_ns) > self.value


class Origin(NamedTuple):
    """Where a node goes on: after the step of a snapshot, which agrees with the journal of that boot."""

    boot: str
    snapshot: Snapshot
    chunk: int  # that has the snapshot


class Indexed:
    """A recording whose index has been read, and its head; chunks are read when they are asked for.

    Raises NoIndexError if it has no index, RecordingError if it is no recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.header, self.attachments = _head(path)
        self._regions: OrderedDict[int, Region] = OrderedDict()  # the last ones read
        self._counted: set[int] = set()  # the chunks that have been read once
        self._file: BinaryIO = open_regular(path)
        try:
            size = os.fstat(self._file.fileno()).st_size
            self._left = MAX_UNPACKED + MAX_RATIO * size  # bytes that chunks may still hold
            self._summary = read_summary(self._file, size)
            self.end = _end(self._file, self._summary)
        except (OSError, ValueError) as error:
            self._file.close()
            raise NoIndexError(f"{path}: {error}") from error
        self._sources = {
            channel.id: Source(channel.topic, channel.metadata["node"], channel.metadata["boot"])
            for channel in self._summary.channels
            if {"node", "boot"} <= channel.metadata.keys()
        }
        schemas = {schema.id: RecordedSchema(schema.name, schema.data) for schema in self._summary.schemas}
        self._schemas = {
            channel.topic: schemas[channel.schema_id]
            for channel in self._summary.channels
            if channel.schema_id in schemas
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def chunks(self) -> int:
        """How many chunks the file has."""
        return len(self._summary.chunks)

    def having(self, topic: str) -> list[int]:
        """Return the numbers of the chunks with messages on a topic."""
        wanted = {channel for channel, source in self._sources.items() if source.topic == topic}
        return [number for number, chunk in enumerate(self._summary.chunks) if not wanted.isdisjoint(chunk.channels)]

    def part(self, first: int, last: int) -> Recording:
        """Return the recording as far as it is in the chunks ``first`` to ``last``, with the head and the end."""
        index = MessageIndex(self.path)
        for number in range(max(0, first), min(last, self.chunks - 1) + 1):
            region = self._region(number)
            index.chunk(region)
            for message in self._messages(number):
                index.add(StreamedMessage(None, *message[:4], region, message.start, message.stop))
        index.close(self._sources)
        return Recording(
            path=self.path,
            header=self.header,
            attachments=self.attachments,
            end=self.end,
            truncated=False,
            index=index,
            schemas=self._schemas,
        )

    def payloads(self, number: int, topic: str) -> Iterator[tuple[str, bytes]]:
        """Yield boot and payload of each message on a topic in a chunk."""
        region = self._region(number)
        for message in self._messages(number):
            source = self._sources.get(message.channel_id)
            if source is not None and source.topic == topic:
                yield source.boot, region.data[message.start : message.stop]

    def _messages(self, number: int) -> Iterator[Message]:
        try:
            for record in contents(self._region(number).data):
                if isinstance(record, Message):
                    yield record
        except ValueError as error:
            raise NoIndexError(f"{self.path}: chunk: {error}") from error

    def _region(self, number: int) -> Region:
        region = self._regions.get(number)
        if region is not None:
            return region
        try:
            region = self._regions[number] = read_chunk(self._file, self._summary.chunks[number])
        except (OSError, ValueError) as error:
            raise NoIndexError(f"{self.path}: {error}") from error
        if len(self._regions) > _KEPT:
            self._regions.popitem(last=False)
        if number not in self._counted:
            self._counted.add(number)
            self._left -= len(region.data)
        if self._left < 0:
            raise NoIndexError(f"{self.path}: its chunks hold more than a file of its size may unpack to")
        return region


def origins(indexed: Indexed, node: str, moment: Moment) -> Iterator[Origin]:
    """Yield the snapshots of a node before its first step at a moment or later, the last one first.

    Only those that agree with the journal are yielded. Raises NoIndexError.
    """
    journal = indexed.having(JOURNAL_PREFIX + node)
    reached = _last_before(indexed, node, journal, moment)
    tried = 0
    for number in reversed([*takewhile(lambda number: number <= reached, indexed.having(SNAPSHOT_PREFIX + node))]):
        # The entry of its step stands before a snapshot, if not in the same chunk, in the last one that has entries.
        before = max([other for other in journal if other <= number], default=number)
        earlier = max([other for other in journal if other < before], default=before)
        entries = [*_entries(indexed, node, earlier), *_entries(indexed, node, before)]
        for boot, payload in reversed([*indexed.payloads(number, SNAPSHOT_PREFIX + node)]):
            try:
                snapshot = decode_snapshot(payload)
                entry = next((one for said_by, one in entries if said_by == boot and one.step == snapshot.step), None)
                agreed(snapshot, entry)
            except BadMessageError:
                tried += 1
                if tried == _TRIES:
                    return
                continue
            if entry is not None and moment.after(entry):
                yield Origin(boot, snapshot, number)


def chunk_at(indexed: Indexed, node: str, moment: Moment) -> int:
    """Return the number of the last chunk in which a node's steps begin before a moment, or at it."""
    return _last_before(indexed, node, indexed.having(JOURNAL_PREFIX + node), moment)


def _last_before(indexed: Indexed, node: str, journal: list[int], moment: Moment) -> int:
    """Return the last chunk of ``journal`` whose first step is not after a moment, by bisection; or the first one."""
    if not journal:
        raise NoIndexError(f"{indexed.path}: holds no journal of {node}")
    low, high = 0, len(journal)
    while high - low > 1:
        middle = (low + high) // 2
        entry = next((entry for _, entry in _entries(indexed, node, journal[middle])), None)
        if entry is None:
            raise NoIndexError(f"{indexed.path}: a chunk lacks the journal of {node} that its summary promises")
        low, high = (low, middle) if moment.before(entry) else (middle, high)
    return journal[low]


def _entries(indexed: Indexed, node: str, number: int) -> Iterator[tuple[str, JournalEntry]]:
    for boot, payload in indexed.payloads(number, JOURNAL_PREFIX + node):
        try:
            yield boot, decode_entry(payload)
        except msgspec.DecodeError as error:
            raise NoIndexError(f"{indexed.path}: journal of {node}: {error}") from error


def _head(path: Path) -> tuple[RunHeader, tuple[Attachment, ...]]:
    """Return what stands before the first chunk; raises RecordingError."""
    header: RunHeader | None = None
    attachments: list[Attachment] = []
    for item in stream(path):
        match item:
            case RunHeader():
                header = item
            case Attachment():
                attachments.append(item)
            case _:
                break
    if header is None:
        raise NoIndexError(f"{path}: damaged before its first message")
    return header, tuple(attachments)


def _end(file: BinaryIO, summary: Summary) -> RunEnd | None:
    found = [place for name, *place in summary.metadata if name == RUN_END]
    return from_entries(read_metadata(file, *found[0]), RunEnd) if len(found) == 1 else None
