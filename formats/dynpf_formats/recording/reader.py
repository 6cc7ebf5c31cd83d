"""Reads a recording: one pass over the file checks every byte and builds an index; payloads are fetched on demand.

The index holds the place of every message, so memory grows with the number of messages and not with their size; a file
cannot claim more messages than its own size allows.
"""

from collections import OrderedDict
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.version import READABLE_VERSIONS
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Header, Metadata

from dynpf_formats.recording.errors import (
    CorruptRecordingError,
    ForeignRecordingError,
    NotMcapError,
    RecordingError,
    TruncatedRecordingError,
    UnknownVersionError,
    UnreadableHeaderError,
)
from dynpf_formats.recording.header import PROFILE, RUN, RUN_END, Attachment, RunEnd, RunHeader, unseal, unsealed
from dynpf_formats.recording.mcap_records import (
    MAGIC,
    Damage,
    DamageKind,
    End,
    Message,
    Region,
    Stray,
    contents,
    scan,
    unpack,
)

__all__ = ["Examined", "Recorded", "Recording", "Source", "load", "read_recording"]

_CACHE_BYTES = 64 * 2**20
_INDEX_ENTRY = 16  # bytes that a file spends on each message beside the chunk, in its message index
_UNINDEXED = 20_000  # messages of a last chunk whose index the recorder had no time to write
_MOST_DAMAGE = 10_000
_LISTED_TOPICS = 8
_FOREIGN_CHUNKS = 16  # chunks of somebody else's file that are searched for topics


class Source(NamedTuple):
    """Who sent on what: messages of one source are numbered without gaps from 0."""

    topic: str
    node: str
    boot: str


_NAMELESS = Source("", "", "")


class _Payloads:
    """Payloads by place: the chunks used last are kept, uncompressed, up to _CACHE_BYTES."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: list[tuple[int, int]] = []
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._cached = 0

    def add(self, region: Region) -> int:
        """Take up a chunk that has just been read; return its number."""
        self._places.append((region.offset, region.length))
        self._keep(len(self._places) - 1, region.data)
        return len(self._places) - 1

    def get(self, chunk: int, start: int, stop: int) -> bytes:
        data = self._cache.get(chunk)
        if data is None:
            data = self._fetch(chunk)
            self._keep(chunk, data)
        else:
            self._cache.move_to_end(chunk)
        return data[start:stop]

    def _keep(self, chunk: int, data: bytes) -> None:
        self._cache[chunk] = data
        self._cached += len(data)
        while self._cached > _CACHE_BYTES and len(self._cache) > 1:
            self._cached -= len(self._cache.popitem(last=False)[1])

    def _fetch(self, chunk: int) -> bytes:
        offset, length = self._places[chunk]
        try:
            with self._path.open("rb") as stream:
                stream.seek(offset)
                return unpack(stream.read(length))
        except (OSError, ValueError) as error:
            raise CorruptRecordingError(f"{self._path}: changed while it was in use: {error}") from error


class Recorded:
    """One recorded message; ``payload`` comes from the file when it is asked for."""

    __slots__ = ("_chunk", "_payloads", "_start", "_stop", "publish_ns", "sequence", "source", "stamp_ns")

    def __init__(self, source: Source, message: Message, payloads: _Payloads, chunk: int) -> None:
        self.source = source
        self.sequence = message.sequence
        self.stamp_ns = message.log_time
        self.publish_ns = message.publish_time
        self._payloads = payloads
        self._chunk = chunk
        self._start = message.start
        self._stop = message.stop

    @property
    def topic(self) -> str:
        return self.source.topic

    @property
    def node(self) -> str:
        return self.source.node

    @property
    def boot(self) -> str:
        return self.source.boot

    @property
    def size(self) -> int:
        """Length of the payload in bytes."""
        return self._stop - self._start

    @property
    def payload(self) -> bytes:
        return self._payloads.get(self._chunk, self._start, self._stop)

    def __repr__(self) -> str:
        return f"Recorded({self.topic} {self.sequence} of {self.node}, boot {self.boot}, at {self.stamp_ns} ns)"


class Recording:
    """One run: how it was made, what was said in it, and how it ended (``end`` is None if nobody wrote that)."""

    def __init__(
        self,
        *,
        path: Path,
        header: RunHeader,
        attachments: tuple[Attachment, ...],
        end: RunEnd | None,
        truncated: bool,
        records: list[Recorded],
    ) -> None:
        self.path = path
        self.header = header
        self.attachments = attachments
        self.end = end
        self.truncated = truncated
        self.records = records
        """Everything, journal and repetitions too, in the order of the file."""

    @cached_property
    def _by_source(self) -> dict[Source, dict[int, Recorded]]:
        """First record of each sequence number; sources in the order in which they appear."""
        found: dict[Source, dict[int, Recorded]] = {}
        for record in self.records:
            found.setdefault(record.source, {}).setdefault(record.sequence, record)
        return found

    @property
    def sources(self) -> tuple[Source, ...]:
        """All sources, journals too, in the order in which they appear."""
        return tuple(self._by_source)

    def boots(self, node: str) -> tuple[str, ...]:
        """Return the starts of a node's process, in the order in which they appear."""
        return tuple(dict.fromkeys(source.boot for source in self._by_source if source.node == node))

    def of(self, source: Source) -> tuple[Recorded, ...]:
        """Return the messages of one source by sequence, each number once."""
        found = self._by_source.get(source, {})
        return tuple(found[sequence] for sequence in sorted(found))

    def find(self, node: str, boot: str, topic: str, sequence: int) -> Recorded | None:
        """Return the message of a reference, or None if it was not recorded."""
        return self._by_source.get(Source(topic, node, boot), {}).get(sequence)

    def messages(self, topic: str | None = None, node: str | None = None) -> Iterator[Recorded]:
        """Yield the messages without the journal, each once, in the order of the file; of one topic or node if told."""
        for record in self.records:
            source = record.source
            wanted = topic in (None, source.topic) and node in (None, source.node)
            if not wanted or source.topic.startswith(JOURNAL_PREFIX):
                continue
            if self._by_source[source][record.sequence] is record:
                yield record

    def journals(self) -> tuple[tuple[str, str], ...]:
        """Return (node, boot) of every journal, in the order in which they appear."""
        return tuple(
            (source.node, source.boot) for source in self._by_source if source.topic == JOURNAL_PREFIX + source.node
        )

    def journal(self, node: str, boot: str) -> Iterator[JournalEntry]:
        """Yield the steps of one start of a node, in order; raises CorruptRecordingError at what is not an entry."""
        for record in self.of(Source(JOURNAL_PREFIX + node, node, boot)):
            try:
                yield decode_entry(record.payload)
            except msgspec.DecodeError as error:
                text = f"{self.path}: journal of {node}, entry {record.sequence}: {error}"
                raise CorruptRecordingError(text) from error

    def tick_of(self, record: Recorded) -> int | None:
        """Return the tick of the step that produced a message, or of the first that consumed one that none produced."""
        return self._ticks.get(record.source, {}).get(record.sequence)

    @cached_property
    def _ticks(self) -> dict[Source, dict[int, int]]:
        produced: dict[Source, dict[int, int]] = {}
        consumed: dict[Source, dict[int, int]] = {}
        for node, boot in self.journals():
            for entry in self.journal(node, boot):
                for made in entry.produced:
                    produced.setdefault(Source(made.topic, node, boot), {})[made.sequence] = entry.tick
                for read in entry.consumed:
                    ticks = consumed.setdefault(Source(read.topic, read.node, read.boot), {})
                    ticks[read.sequence] = min(entry.tick, ticks.get(read.sequence, entry.tick))
        return {source: {**consumed.get(source, {}), **produced.get(source, {})} for source in {**consumed, **produced}}


class Examined(NamedTuple):
    """A recording as far as it could be read, and the damage that was found on the way."""

    recording: Recording
    damage: tuple[Damage, ...]


def read_recording(path: Path | str, allow_truncated: bool = False) -> Recording:
    """Return the recording in a file, all of whose checksums are right.

    Raises a RecordingError that says what is wrong. A file that was cut off, such as that of a recorder which was
    killed, is refused too, unless ``allow_truncated``: then it is read up to its last whole chunk.
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
    """Return what can be read of a recording, together with the damage; raises RecordingError if it has no header."""
    path = Path(path)
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            start = stream.read(len(MAGIC))
            if size == 0:
                raise NotMcapError(f"{path}: the file is empty; expected a recording")
            if start != MAGIC:
                if MAGIC.startswith(start):
                    raise TruncatedRecordingError(f"{path}: the file ends inside its first bytes; nothing is recorded")
                raise NotMcapError(f"{path}: not an MCAP file: it begins with {start!r}")
            return _Loader(path, size).load(scan(stream, size))
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


class _Loader:
    """Gathers what the scan of one file yields."""

    def __init__(self, path: Path, size: int) -> None:
        self._path = path
        self._most = size // _INDEX_ENTRY + _UNINDEXED
        self._profile: str | None = None
        self._header: RunHeader | None = None
        self._attachments: list[Attachment] = []
        self._end: RunEnd | None = None
        self._payloads = _Payloads(path)
        self._sources: dict[int, Source] = {}
        self._records: list[Recorded] = []
        self._nameless: list[tuple[int, Recorded]] = []  # messages on channels not described so far
        self._damage: list[Damage] = []
        self._ended = False

    def load(self, items: Iterator[object]) -> Examined:
        for item in items:
            if self._header is None and isinstance(item, Region | Stray | Channel | End):
                raise self._headless() if self._profile == PROFILE else self._foreign(item, items)
            self._take(item)
        if self._header is None:
            raise self._headless()
        self._name_the_nameless()
        recording = Recording(
            path=self._path,
            header=self._header,
            attachments=tuple(self._attachments),
            end=self._end,
            truncated=not self._ended,
            records=self._records,
        )
        return Examined(recording, tuple(self._damage))

    def _take(self, item: object) -> None:
        if len(self._damage) >= _MOST_DAMAGE:
            raise CorruptRecordingError(f"{self._path}: damaged in more than {_MOST_DAMAGE} places")
        match item:
            case Header():
                self._profile = item.profile
            case Metadata(name=name, metadata=entries) if name == RUN and self._header is None:
                self._header = self._run_header(entries)
            case Metadata(name=name, metadata=entries) if name == RUN_END:
                self._run_end(entries)
            case AttachmentRecord():
                self._attachments.append(Attachment(name=item.name, media_type=item.media_type, data=item.data))
            case Region():
                self._region(item)
            case Channel():
                self._channel(item, 0)
            case Stray():
                self._damage.append(Damage(DamageKind.MALFORMED, item.offset, f"a {item.what} outside a chunk"))
            case Damage():
                self._damage.append(item)
            case End():
                self._ended = True

    def _region(self, region: Region) -> None:
        chunk = self._payloads.add(region)
        try:
            for record in contents(region.data):
                if isinstance(record, Message):
                    self._message(record, chunk)
                elif isinstance(record, Channel):
                    self._channel(record, region.offset)
        except ValueError as error:
            self._damage.append(Damage(DamageKind.MALFORMED, region.offset, f"chunk: {error}"))

    def _message(self, message: Message, chunk: int) -> None:
        if len(self._records) >= self._most:
            raise CorruptRecordingError(f"{self._path}: claims more messages than a file of its size can hold")
        source = self._sources.get(message.channel_id)
        record = Recorded(source or _NAMELESS, message, self._payloads, chunk)
        if source is None:
            self._nameless.append((message.channel_id, record))
        self._records.append(record)

    def _channel(self, channel: Channel, offset: int) -> None:
        try:
            source = Source(channel.topic, channel.metadata["node"], channel.metadata["boot"])
        except KeyError as missing:
            text = f"channel {channel.id} of topic {channel.topic!r} does not name its {missing.args[0]}"
            self._damage.append(Damage(DamageKind.MALFORMED, offset, text))
            return
        known = self._sources.setdefault(channel.id, source)
        if known != source:
            text = f"channel {channel.id} is {known.topic!r} of {known.node!r} and {source.topic!r} of {source.node!r}"
            self._damage.append(Damage(DamageKind.MALFORMED, offset, text))

    def _name_the_nameless(self) -> None:
        """Where the chunk that described a channel is lost, the summary at the end still describes it."""
        for channel, record in self._nameless:
            record.source = self._sources.get(channel, _NAMELESS)
        known = [record for record in self._records if record.source is not _NAMELESS]
        lost = len(self._records) - len(known)
        self._records = known
        if lost:
            text = f"{lost} messages are on channels that the file does not describe"
            self._damage.append(Damage(DamageKind.MALFORMED, 0, text))

    def _run_header(self, entries: dict[str, str]) -> RunHeader:
        if unsealed(entries):
            raise UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable: checksum mismatch")
        version = entries.get("schema_version", "none")
        if version not in map(str, READABLE_VERSIONS):
            readable = ", ".join(map(str, READABLE_VERSIONS))
            writer = entries.get("dynpf_version", "unknown")
            raise UnknownVersionError(
                f"{self._path}: schema version {version}, written by dynpf {writer}; this dynpf reads {readable}"
            )
        try:
            return unseal(entries, RunHeader)
        except ValueError as error:
            raise UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable: {error}") from error

    def _run_end(self, entries: dict[str, str]) -> None:
        try:
            self._end = unseal(entries, RunEnd)
        except ValueError as error:
            self._damage.append(Damage(DamageKind.CHECKSUM, 0, f"the metadata of the run's end: {error}"))

    def _foreign(self, item: object, items: Iterator[object]) -> ForeignRecordingError:
        topics: dict[str, None] = {}
        chunks = 0
        while item is not None and chunks < _FOREIGN_CHUNKS and len(topics) <= _LISTED_TOPICS:
            if isinstance(item, Stray | Channel) and item.topic:
                topics[item.topic] = None
            elif isinstance(item, Region):
                chunks += 1
                topics.update(dict.fromkeys(_topics(item.data)))
            item = next(items, None)
        names = [*topics][:_LISTED_TOPICS]
        listed = ", ".join(map(repr, names)) + (", ..." if len(topics) > len(names) else "")
        return ForeignRecordingError(
            f"{self._path}: not a dynpf recording: no run metadata; profile {self._profile or ''!r}, "
            + (f"topics {listed}" if names else "no topics")
        )

    def _headless(self) -> RecordingError:
        if self._profile not in (None, PROFILE):
            return self._foreign(None, iter(()))
        if self._damage and self._damage[-1].kind is DamageKind.TRUNCATED:
            return TruncatedRecordingError(f"{self._path}: the file ends before the metadata of the run")
        found = f": {self._damage[0].text} (at byte {self._damage[0].offset})" if self._damage else ""
        return UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable{found}")


def _topics(data: bytes) -> Iterator[str]:
    try:
        yield from (record.topic for record in contents(data) if isinstance(record, Channel))
    except ValueError:
        return
