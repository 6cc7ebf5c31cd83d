"""One pass over a recording: its items in the order of the file, every byte checked.

Memory is bounded by one record, one chunk, and the number of senders and topics, whatever the number of messages.
"""

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from dynpf_protocol.version import READABLE_VERSIONS
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Header, Metadata, Schema

from dynpf_formats.recording.errors import (
    CorruptRecordingError,
    ForeignRecordingError,
    NotMcapError,
    RecordingError,
    TruncatedRecordingError,
    UnknownVersionError,
    UnreadableHeaderError,
)
from dynpf_formats.recording.header import (
    PROFILE,
    RUN,
    RUN_END,
    Attachment,
    RunEnd,
    RunHeader,
    checksum_is_broken,
    from_entries,
)
from dynpf_formats.recording.mcap_records import MAGIC, Damage, DamageKind, End, Message, Region, Stray, contents, scan
from dynpf_formats.regular_files import open_regular

__all__ = ["Described", "Item", "RecordedSchema", "Source", "StreamedMessage", "stream"]

_INDEX_ENTRY = 16  # bytes per message in a chunk's message index
_UNINDEXED = 20_000  # messages of a last chunk whose index the recorder did not get to write
_MOST_DAMAGE = 10_000
_LARGEST_CHUNK = 8 * 2**20  # bytes, of more than one message; larger ones hold one alone
_LARGEST_ATTACHED = 2**27  # bytes of all attachments
_LISTED_TOPICS = 8
_LONGEST_SHOWN = 80  # characters of a name in a text
_FOREIGN_CHUNKS = 16  # chunks of a foreign file that are searched for topics
_FOREIGN_RECORDS = 2000  # records of each of them


class Source(NamedTuple):
    """Topic and sender; messages of one source are numbered without gaps from 0."""

    topic: str
    node: str
    boot: str


class RecordedSchema(NamedTuple):
    """The recorded type of a topic's messages: its name and JSON schema."""

    name: str
    data: bytes


class Described(NamedTuple):
    """The source of a channel's messages; it comes once per channel, usually before its messages.

    ``schema`` is None if the file has lost it.
    """

    channel: int
    source: Source
    schema: RecordedSchema | None


class StreamedMessage(NamedTuple):
    """One message or journal entry, in its uncompressed chunk.

    ``source`` is None if the chunk that described the channel is lost; a description may still come at the end of the
    file. A streamed message keeps its whole chunk in memory.
    """

    source: Source | None
    channel: int
    sequence: int
    stamp_ns: int
    publish_ns: int
    chunk: Region
    start: int
    stop: int

    @property
    def payload(self) -> bytes:
        """The encoded message."""
        return self.chunk.data[self.start : self.stop]


Item = RunHeader | Attachment | Region | Described | StreamedMessage | RunEnd | Damage | End
"""An item of a recording: a Region comes before the messages in it, the RunHeader before all but attachments and
damage, and an End if the file has its footer."""


def stream(path: Path | str) -> Iterator[Item]:
    """Yield the readable items of a recording and the damage, in the order of the file.

    Raises RecordingError if the file cannot be read or has no header.
    """
    path = Path(path)
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            start = file.read(len(MAGIC))
            if size == 0:
                raise NotMcapError(f"{path}: the file is empty; expected a recording")
            if start != MAGIC:
                if MAGIC.startswith(start):
                    raise TruncatedRecordingError(f"{path}: the file ends inside its first bytes; nothing is recorded")
                raise NotMcapError(f"{path}: not an MCAP file: it begins with {start!r}{_importer_of(start)}")
            yield from _Pass(path, size).items(scan(file, size))
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise RecordingError(
            f"{path}: cannot be read: it is a folder; of a ROS 2 bag dynpf import rosbag makes a recording"
        ) from None
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from error


def _importer_of(start: bytes) -> str:
    """Return which command makes a recording of a file that begins so, as the end of a sentence."""
    if start.startswith((b"#ROSBAG", b"SQLite")):
        return "; it is a bag: dynpf import rosbag makes a log of it, and dynpf localize does all in one"
    return ""


class _Pass:
    """The state of one pass."""

    def __init__(self, path: Path, size: int) -> None:
        self._path = path
        self._most = size // _INDEX_ENTRY + _UNINDEXED
        self._messages = 0
        self._descriptions = 0  # records of channels and schemas
        self._attached: set[str] = set()  # names of attachments
        self._attached_bytes = 0
        self._profile: str | None = None
        self._headed = False
        self._sources: dict[int, Source] = {}
        self._schemas: dict[int, RecordedSchema] = {}
        self._nameless: dict[int, int] = {}  # messages on channels not described so far
        self._damaged = 0
        self._first_damage: Damage | None = None
        self._last_damage: Damage | None = None

    def items(self, records: Iterator[object]) -> Iterator[Item]:
        """Yield the items that the MCAP records hold; raises RecordingError if they are no recording."""
        for record in records:
            if not self._headed and isinstance(record, Region | Stray | Channel | End):
                raise self._headless() if self._profile == PROFILE else self._foreign(record, records)
            for item in self._read(record):
                if isinstance(item, Damage):
                    self._damaged += 1
                    if self._damaged > _MOST_DAMAGE:
                        raise CorruptRecordingError(f"{self._path}: damaged in more than {_MOST_DAMAGE} places")
                    self._first_damage = self._first_damage or item
                    self._last_damage = item
                yield item
        if not self._headed:
            raise self._headless()
        # If the chunk that described a channel is lost, the summary at the end still describes it.
        lost = sum(count for channel, count in self._nameless.items() if channel not in self._sources)
        if lost:
            yield Damage(DamageKind.MALFORMED, 0, f"{lost} messages are on channels that the file does not describe")

    def _read(self, record: object) -> Iterator[Item]:
        match record:
            case Header():
                self._profile = record.profile
            case Metadata(name=name, metadata=entries) if name == RUN and not self._headed:
                header = self._run_header(entries)
                self._headed = True
                yield header
            case Metadata(name=name, metadata=entries) if name == RUN_END:
                yield _run_end(entries)
            case Metadata(name=name):
                what = "the metadata of the run again" if name == RUN else f"the foreign metadata {_shown(name)}"
                yield Damage(DamageKind.MALFORMED, 0, f"the file holds {what}")
            case AttachmentRecord():
                yield from self._attachment(record)
            case Region():
                yield from self._region(record)
            case Schema():
                yield from self._schema(record, 0)
            case Channel():
                yield from self._channel(record, 0)
            case Stray():
                yield Damage(DamageKind.MALFORMED, record.offset, f"a {record.what} outside a chunk")
            case Damage() | End():
                yield record

    def _region(self, region: Region) -> Iterator[Item]:
        yield region
        messages = 0
        try:
            for record in contents(region.data):
                if isinstance(record, Message):
                    messages += 1
                    if messages > 1 and len(region.data) > _LARGEST_CHUNK:
                        text = f"a chunk of {len(region.data)} bytes; of several messages it has at most "
                        yield Damage(DamageKind.OVERSIZE, region.offset, f"{text}{_LARGEST_CHUNK}")
                        return
                    yield self._message(record, region)
                elif isinstance(record, Channel):
                    yield from self._channel(record, region.offset)
                else:
                    yield from self._schema(record, region.offset)
        except ValueError as error:
            yield Damage(DamageKind.MALFORMED, region.offset, f"chunk: {error}")

    def _message(self, message: Message, region: Region) -> StreamedMessage:
        if self._messages >= self._most:
            raise CorruptRecordingError(f"{self._path}: claims more messages than a file of its size can hold")
        self._messages += 1
        channel, sequence, stamp_ns, publish_ns, start, stop = message
        source = self._sources.get(channel)
        if source is None:
            self._nameless[channel] = self._nameless.get(channel, 0) + 1
        return StreamedMessage(source, channel, sequence, stamp_ns, publish_ns, region, start, stop)

    def _attachment(self, record: AttachmentRecord) -> Iterator[Attachment | Damage]:
        self._attached_bytes += len(record.data)
        if self._attached_bytes > _LARGEST_ATTACHED:
            raise CorruptRecordingError(f"{self._path}: has attachments of over {_LARGEST_ATTACHED} bytes")
        if record.name in self._attached:
            yield Damage(
                DamageKind.MALFORMED, 0, f"two attachments are called {_shown(record.name)}; the first is taken"
            )
            return
        self._attached.add(record.name)
        if record.log_time or record.create_time:
            text = f"attachment {_shown(record.name)} has a time; those of a recording have none"
            yield Damage(DamageKind.MALFORMED, 0, text)
        yield Attachment(name=record.name, media_type=record.media_type, data=record.data)

    def _described(self) -> None:
        """Count a channel or a schema; there cannot be more than messages."""
        self._descriptions += 1
        if self._descriptions > self._most:
            raise CorruptRecordingError(f"{self._path}: claims more channels and schemas than a file of its size holds")

    def _schema(self, schema: Schema, offset: int) -> Iterator[Damage]:
        self._described()
        described = RecordedSchema(schema.name, schema.data)
        if self._schemas.setdefault(schema.id, described) != described:
            yield Damage(DamageKind.MALFORMED, offset, f"schema {schema.id} is described in two ways")
        if schema.encoding != "jsonschema":
            text = f"schema {schema.id} is in {_shown(schema.encoding)}; expected 'jsonschema'"
            yield Damage(DamageKind.MALFORMED, offset, text)

    def _channel(self, channel: Channel, offset: int) -> Iterator[Described | Damage]:
        self._described()
        try:
            source = Source(channel.topic, channel.metadata["node"], channel.metadata["boot"])
        except KeyError as missing:
            text = f"channel {channel.id} of topic {_shown(channel.topic)} does not name its {missing.args[0]}"
            yield Damage(DamageKind.MALFORMED, offset, text)
            return
        others = [name for name in channel.metadata if name not in ("node", "boot")]
        if others:
            text = f"channel {channel.id} has the foreign entry {_shown(others[0])}"
            yield Damage(DamageKind.MALFORMED, offset, text)
        if channel.message_encoding != "json":
            text = f"channel {channel.id} has messages in {_shown(channel.message_encoding)}; expected 'json'"
            yield Damage(DamageKind.MALFORMED, offset, text)
        known = self._sources.get(channel.id)
        if known is None:
            self._sources[channel.id] = source
            yield Described(channel.id, source, self._schemas.get(channel.schema_id))
        elif known != source:
            both = (f"{_shown(topic)} of {_shown(node)}" for topic, node, _ in (known, source))
            text = f"channel {channel.id} is {' and '.join(both)}"
            yield Damage(DamageKind.MALFORMED, offset, text)

    def _run_header(self, entries: dict[str, str]) -> RunHeader:
        if checksum_is_broken(entries):
            raise UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable: checksum mismatch")
        version = entries.get("schema_version", "none")
        if version not in map(str, READABLE_VERSIONS):
            readable = ", ".join(map(str, READABLE_VERSIONS))
            writer = entries.get("dynpf_version", "unknown")
            raise UnknownVersionError(
                f"{self._path}: schema version {version}, written by dynpf {writer}; this dynpf reads {readable}"
            )
        try:
            return from_entries(entries, RunHeader)
        except ValueError as error:
            raise UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable: {error}") from error

    def _foreign(self, record: object, records: Iterator[object]) -> ForeignRecordingError:
        topics: dict[str, None] = {}
        chunks = 0
        while record is not None and chunks < _FOREIGN_CHUNKS and len(topics) <= _LISTED_TOPICS:
            if isinstance(record, Stray | Channel) and record.topic:
                topics[record.topic] = None
            elif isinstance(record, Region):
                chunks += 1
                topics.update(dict.fromkeys(_topics(record.data)))
            record = next(records, None)
        names = [*topics][:_LISTED_TOPICS]
        listed = ", ".join(map(_shown, names)) + (", ..." if len(topics) > len(names) else "")
        return ForeignRecordingError(
            f"{self._path}: not a dynpf recording: no run metadata; profile {self._profile or ''!r}, "
            + (f"topics {listed}" if names else "no topics")
            + ("; dynpf import rosbag makes a log of it" if self._profile == "ros2" else "")
        )

    def _headless(self) -> RecordingError:
        if self._profile not in (None, PROFILE):
            return self._foreign(None, iter(()))
        if self._last_damage is not None and self._last_damage.kind is DamageKind.TRUNCATED:
            return TruncatedRecordingError(f"{self._path}: the file ends before the metadata of the run")
        first = self._first_damage
        found = f": {first.text} (at byte {first.offset})" if first is not None else ""
        return UnreadableHeaderError(f"{self._path}: the metadata of the run are unreadable{found}")


def _run_end(entries: dict[str, str]) -> RunEnd | Damage:
    try:
        return from_entries(entries, RunEnd)
    except ValueError as error:
        return Damage(DamageKind.CHECKSUM, 0, f"the metadata of the run's end: {error}")


def _shown(name: str) -> str:
    """Return a name of the file as texts show it, however long it is."""
    return repr(name if len(name) <= _LONGEST_SHOWN else f"{name[:_LONGEST_SHOWN]}...")


def _topics(data: bytes) -> Iterator[str]:
    try:
        yield from (record.topic for record in islice(contents(data), _FOREIGN_RECORDS) if isinstance(record, Channel))
    except ValueError:
        return
