"""Reads a recording: one pass over the file checks every byte and builds an index; payloads are fetched on demand.

The index holds the offset of every message in arrays, so memory grows by some tens of bytes per message, not with their
size; a file cannot claim more messages than its own size allows. A single pass in the order of the file needs only
``stream``.
"""

from array import array
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.topics import Topic
from msgspec.structs import replace

from dynpf_formats.recording.errors import CorruptRecordingError, TruncatedRecordingError
from dynpf_formats.recording.header import Attachment, RunEnd, RunHeader
from dynpf_formats.recording.index import MessageIndex, Recorded, Records
from dynpf_formats.recording.mcap_records import Damage, DamageKind, End, Region
from dynpf_formats.recording.stream import Described, RecordedSchema, Source, StreamedMessage, stream
from dynpf_formats.shipped import known_topics

__all__ = ["Examined", "Recorded", "Recording", "Records", "Source", "load", "read_recording"]

_NO_TICK = 2**64 - 1


class Recording:
    """One recorded run: header, messages, journals, and end (None if it was never written)."""

    def __init__(
        self,
        *,
        path: Path,
        header: RunHeader,
        attachments: tuple[Attachment, ...],
        end: RunEnd | None,
        truncated: bool,
        index: MessageIndex,
        schemas: Mapping[str, RecordedSchema],
    ) -> None:
        self.path = path
        self.header = header
        self.attachments = attachments
        self.end = end
        self.truncated = truncated
        self.schemas = schemas
        """The schema of each topic's messages, as recorded."""
        self.records = index.all()
        """All messages, with journal entries and repetitions, in the order of the file."""
        self._index = index

    @cached_property
    def topics(self) -> Mapping[str, Topic]:
        """The topics whose message types dynpf has: its own topics, and others by the names of their schemas."""
        known = {row.type.schema_name: row for row in known_topics().values()}
        others = {name: known[schema.name] for name, schema in self.schemas.items() if schema.name in known}
        return {**{name: replace(row, name=name) for name, row in others.items()}, **known_topics()}

    @property
    def sources(self) -> tuple[Source, ...]:
        """All sources, including journals, in the order in which they appear."""
        return self._index.sources

    def boots(self, node: str) -> tuple[str, ...]:
        """Return the starts of a node's process, in the order in which they appear."""
        return tuple(dict.fromkeys(source.boot for source in self.sources if source.node == node))

    def of(self, source: Source) -> Records:
        """Return the messages of one source by sequence number, each number once."""
        return self._index.of(source)

    def find(self, node: str, boot: str, topic: str, sequence: int) -> Recorded | None:
        """Return the message that a reference names, or None if it was not recorded."""
        position = self._index.find((topic, node, boot), sequence)
        return None if position is None else Recorded(self._index, position)

    def messages(self, topic: str | None = None, node: str | None = None) -> Iterator[Recorded]:
        """Yield messages but not the journal, each once, in the order of the file; of one topic or node if given."""
        wanted = [
            topic in (None, source.topic)
            and node in (None, source.node)
            and not source.topic.startswith(JOURNAL_PREFIX)
            for source in self.sources
        ]
        for position in self._index.firsts(wanted):
            yield Recorded(self._index, position)

    def rows(self) -> Iterator[tuple[Source, int, int, int, bytes]]:
        """Yield source, sequence number, logical and publish time, and payload of all ``records``, in their order."""
        return self._index.rows()

    def repetitions(self) -> Iterator[tuple[Recorded, Recorded]]:
        """Yield each repeated message in the order of the file, as a pair: the first with that number, the repeated."""
        for position in self._index.repeated():
            record = Recorded(self._index, position)
            first = self._index.find(record.source, record.sequence)
            assert first is not None
            yield Recorded(self._index, first), record

    def journals(self) -> tuple[tuple[str, str], ...]:
        """Return (node, boot) of every journal, in the order in which they appear."""
        return tuple(
            (source.node, source.boot) for source in self.sources if source.topic == JOURNAL_PREFIX + source.node
        )

    def journal(self, node: str, boot: str) -> Iterator[JournalEntry]:
        """Yield the steps of one start of a node, in order; raises CorruptRecordingError at an undecodable entry."""
        for record in self.of(Source(JOURNAL_PREFIX + node, node, boot)):
            try:
                entry = decode_entry(record.payload)
            except msgspec.DecodeError as error:
                where = f"{self.path}: journal of {node}, entry {record.sequence}"
                raise CorruptRecordingError(f"{where}: {error}") from error
            yield entry

    def tick_of(self, record: Recorded) -> int | None:
        """Return the tick of the step that produced a message; if none did, of the first step that consumed it."""
        position = record.position
        if not self._index.is_first(position):
            position = self._index.find(record.source, record.sequence) or 0
        tick = self._ticks[position]
        return None if tick == _NO_TICK else tick

    @cached_property
    def _ticks(self) -> "array[int]":
        """The tick of each message by position, or _NO_TICK."""
        produced = array("Q", [_NO_TICK]) * len(self.records)
        consumed = array("Q", [_NO_TICK]) * len(self.records)
        for node, boot in self.journals():
            for entry in self.journal(node, boot):
                for made in entry.produced:
                    position = self._index.find((made.topic, node, boot), made.sequence)
                    if position is not None:
                        produced[position] = entry.tick
                for read in entry.consumed:
                    position = self._index.find((read.topic, read.node, read.boot), read.sequence)
                    if position is not None:
                        consumed[position] = min(consumed[position], entry.tick)
        for position, tick in enumerate(consumed):
            if produced[position] == _NO_TICK:
                produced[position] = tick
        return produced


class Examined(NamedTuple):
    """A recording as far as it could be read, and the damage found."""

    recording: Recording
    damage: tuple[Damage, ...]


def read_recording(path: Path | str, allow_truncated: bool = False) -> Recording:
    """Return the recording in a file, after checking all checksums.

    Raises a RecordingError that says what is wrong. A truncated file, such as that of a killed recorder, is refused
    too unless ``allow_truncated``: then it is read up to its last whole chunk.
    """
    recording, damage = load(path)
    for found in damage:
        text = f"{recording.path}: {found.text} (at byte {found.offset})"
        if found.kind is not DamageKind.TRUNCATED:
            raise CorruptRecordingError(text)
        if not allow_truncated:
            messages = len(recording.records)
            raise TruncatedRecordingError(f"{text}; {messages} messages before that can be recovered")
    return recording


def load(path: Path | str) -> Examined:
    """Return the readable part of a recording, and the damage; raises RecordingError if it has no header."""
    path = Path(path)
    header: RunHeader | None = None
    attachments: list[Attachment] = []
    end: RunEnd | None = None
    truncated = True
    index = MessageIndex(path)
    described: dict[int, Source] = {}
    schemas: dict[str, RecordedSchema] = {}
    damage: list[Damage] = []
    for item in stream(path):
        match item:
            case StreamedMessage():
                index.add(item)
            case Region():
                index.chunk(item)
            case Described():
                described[item.channel] = item.source
                topic = item.source.topic
                if item.schema is not None and schemas.setdefault(topic, item.schema) != item.schema:
                    damage.append(Damage(DamageKind.MALFORMED, 0, f"topic {topic!r:.80} has two schemas"))
            case RunHeader():
                header = item
            case Attachment():
                attachments.append(item)
            case RunEnd() if end is None:
                end = item
            case RunEnd():
                damage.append(Damage(DamageKind.MALFORMED, 0, "the end of the run is written more than once"))
            case Damage():
                damage.append(item)
            case End():
                truncated = False
    assert header is not None, "the stream of a file without a header raises"
    index.close(described)
    recording = Recording(
        path=path,
        header=header,
        attachments=tuple(attachments),
        end=end,
        truncated=truncated,
        index=index,
        schemas=schemas,
    )
    return Examined(recording, tuple(damage))
