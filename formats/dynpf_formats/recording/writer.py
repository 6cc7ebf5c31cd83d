"""Writes a recording: registers channels on demand, closes chunks in time, and accounts for missing messages."""

import functools
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.messages import Message
from dynpf_protocol.schemas import json_schema
from dynpf_protocol.topics import Topic, topic
from mcap.writer import Writer

from dynpf_formats.recording.account import Account
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.files import File, PlainFile, already_there, unwritable
from dynpf_formats.recording.header import PROFILE, RUN, RUN_END, Attachment, RunEnd, RunHeader, as_entries
from dynpf_formats.recording.stream import RecordedSchema, Source
from dynpf_formats.shipped import known_topics

__all__ = ["CHUNK_BYTES", "FLUSH_NS", "MAX_PAYLOAD", "RecordingWriter"]

CHUNK_BYTES = 256 * 1024
"""Largest chunk, uncompressed, in bytes; only a single larger message makes a larger chunk."""

FLUSH_NS = 250_000_000
"""The longest time, in nanoseconds, before a message is handed to the operating system."""

MAX_PAYLOAD = 32 * 2**20
"""Largest payload and attachment, in bytes; well below what the reader accepts as a record."""

_MESSAGE_OVERHEAD = 31  # opcode, length and fields of a message record before its payload
_MAX_CHANNELS = 2**16 - 1

_RECORDER = "recorder"
_GAP_TOPIC = "recorder/gap"


class RecordingWriter:
    """Writes one run to ``path``.

    Missing messages are found by their sequence numbers, per topic, node and boot: each gap is written as a
    ``recorder/gap`` message when it is noticed, and gaps that stay open are listed at the end. Duplicate and late
    messages are recorded and counted. The end seals what is in the file. Raises RecordingExistsError, or RecordingError
    if the file cannot be written; after that everything up to the last whole chunk can be recovered.
    """

    def __init__(
        self,
        path: Path | str,
        header: RunHeader,
        attachments: tuple[Attachment, ...] = (),
        *,
        overwrite: bool = False,
        draft: Path | None = None,
        boot: str = "recorder",
        topics: Mapping[str, Topic] | None = None,
        schemas: Mapping[str, RecordedSchema] = {},
        durable: bool = False,
        open_file: Callable[[Path, bool], File] = PlainFile,
    ) -> None:
        """Open the file and write the header and the attachments.

        All goes into the file ``draft``, if one is given, until ``place`` moves that to ``path``.
        ``topics`` are the run's, by default those that come with dynpf. ``schemas`` are those of another recording of
        the run, for topics whose types are not available. What is handed on by a ``durable`` writer survives a loss of
        power, too. ``open_file`` opens the file, and is told whether it may replace one; it raises OSError.
        """
        self.path = Path(path)
        self.header = header
        self._topics = known_topics() if topics is None else topics
        self._boot = boot
        self._durable = durable
        self._account = Account(header, attachments)
        self._channels: dict[Source, int] = {}
        self._schemas = schemas
        self._registered: dict[RecordedSchema, int] = {}
        self._gaps = 0
        self._pending = 0  # bytes in the open chunk
        self._flushed_ns: int | None = None
        self._failure: RecordingError | None = None
        self._closed = False
        for attachment in attachments:
            _check_size(self.path, f"attachment {attachment.name!r}", len(attachment.data))
        try:
            self._draft = draft
            self._file = open_file(draft or self.path, overwrite or draft is not None)
        except FileExistsError:
            raise already_there(self.path) from None
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._mcap = Writer(self._file, chunk_size=2 * CHUNK_BYTES, enable_data_crcs=True)  # type: ignore[arg-type]
        try:
            self._mcap.start(PROFILE)
            self._mcap.add_metadata(RUN, as_entries(header))
            for item in attachments:
                self._mcap.add_attachment(0, 0, item.name, item.media_type, item.data)
        except OSError as error:
            self._file.close()
            raise unwritable(self.path, error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._closed:
            self.close(complete=False, reason=f"ended by {kind.__name__}: {error}" if kind else "never closed")

    @property
    def messages(self) -> int:
        """Messages recorded so far, without the journal."""
        return self._account.messages

    @property
    def missing(self) -> int:
        """Messages known to be missing so far."""
        return self._account.missing

    def journal(self, envelope: Envelope, payload: bytes) -> None:
        """Record one journal entry of the envelope's node; the envelope's sequence counts entries."""
        self.message(JOURNAL_PREFIX + envelope.node, envelope, payload)

    def message(self, name: str, envelope: Envelope, payload: bytes, entry: JournalEntry | None = None) -> None:
        """Record one message or journal entry. The envelope's tick is not recorded: the journal has it.

        ``entry`` is the decoded payload of a journal entry, if the caller has it. Raises UnknownTopicError,
        BadMessageError for an undecodable journal entry, RecordingError.
        """
        if self._failure is not None:
            raise self._failure
        if len(payload) > MAX_PAYLOAD:
            _check_size(self.path, f"message {envelope.sequence} on {name}", len(payload))
        if entry is None and name.startswith(JOURNAL_PREFIX):
            entry = _entry(name, payload)
        source = Source(name, envelope.node, envelope.boot)
        if source not in self._channels:
            self._described(name)  # a topic that is unknown leaves no gap
        gap = self._account.gap(source, envelope.sequence)
        if gap is not None:
            number, self._gaps = self._gaps, self._gaps + 1
            noticed = Envelope(_RECORDER, self._boot, number, envelope.tick, envelope.stamp_ns, envelope.publish_ns)
            self.message(_GAP_TOPIC, noticed, encode(_GAP_TOPIC, gap))
        channel = self._channels.get(source)
        if channel is None:  # senders are sealed in the order of their first messages: the gap's is before this one
            channel = self._open(source)
        size = len(payload) + _MESSAGE_OVERHEAD
        try:
            if self._pending + size > CHUNK_BYTES:
                self._hand_on()
            self._pending += size
            self._mcap.add_message(channel, envelope.stamp_ns, payload, envelope.publish_ns, envelope.sequence)
        except OSError as error:
            raise self._fail(error) from error
        self._account.add(source, envelope.sequence, envelope.stamp_ns, envelope.publish_ns, payload, entry=entry)

    def place(self, *, replace: bool) -> None:
        """Hand all so far to the operating system, and move the draft to the recording's path.

        A file that is there is replaced, or else RecordingExistsError raised.
        """
        assert self._draft is not None, "the recording is in its place"
        try:
            self._hand_on()
            if replace:
                self._draft.replace(self.path)
            else:
                _move_new(self._draft, self.path)
            if self._durable:
                _sync_folder(self.path.parent)
        except FileExistsError:
            raise already_there(self.path) from None
        except OSError as error:
            raise self._fail(error) from error
        self._draft = None

    def discard(self) -> None:
        """Remove the draft: nothing more is written."""
        assert self._draft is not None, "the recording is in its place"
        self._closed = True
        self._file.close()
        self._draft.unlink(missing_ok=True)

    def flush_if_due(self, now_ns: int) -> bool:
        """Close the chunk and hand it to the operating system if the last flush is FLUSH_NS ago; call this often.

        Returns whether it has.
        """
        if self._failure is not None:
            raise self._failure
        if self._flushed_ns is None:
            self._flushed_ns = now_ns
        if now_ns - self._flushed_ns < FLUSH_NS:
            return False
        self._flushed_ns = now_ns
        try:
            self._hand_on()
        except OSError as error:
            raise self._fail(error) from error
        return True

    def close(self, complete: bool, reason: str, outcome: str = "") -> RunEnd:
        """End the recording and return the end that was written.

        A run is not complete, whatever the caller passes, if its journal refers to messages that were never received,
        if a node's last step is missing, or if a message was produced by no step. After a failure to write, nothing
        more is written, and the end says so.
        """
        if self._failure is not None:
            complete, reason = False, str(self._failure)
        end = self._account.end(complete, reason, outcome)
        if self._closed:
            return end
        self._closed = True
        failed = self._failure
        self._failure = failed or RecordingError(f"{self.path}: the recording has been closed")
        try:
            if failed is None:
                self._flush()
                self._mcap.add_metadata(RUN_END, as_entries(end))
                self._mcap.finish()  # type: ignore[no-untyped-call]
                self._sync()
        except OSError as error:
            raise self._fail(error) from error
        finally:
            self._file.close()
        return end

    def _open(self, source: Source) -> int:
        name, node, boot = source
        if len(self._channels) >= _MAX_CHANNELS:
            raise RecordingError(f"{self.path}: more than {_MAX_CHANNELS} senders and topics in one recording")
        described = self._described(name)
        schema = self._registered.get(described)
        if schema is None:
            schema = self._mcap.register_schema(described.name, "jsonschema", described.data)
            self._registered[described] = schema
        channel = self._mcap.register_channel(name, "json", schema, {"node": node, "boot": boot})
        self._channels[source] = channel
        self._account.open(source, described)
        return channel

    def _described(self, name: str) -> RecordedSchema:
        """Return the schema of a topic: that of its type, else that in ``schemas``; raises UnknownTopicError."""
        if name.startswith(JOURNAL_PREFIX):
            return RecordedSchema(JournalEntry.schema_name, _schema(JournalEntry))
        if name not in self._topics and name in self._schemas:
            return self._schemas[name]
        kind = topic(name, self._topics).type
        return RecordedSchema(kind.schema_name, _schema(kind))

    def _flush(self) -> None:
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._pending = 0
        self._account.settle()

    def _hand_on(self) -> None:
        """Close the chunk, and have all so far survive the end of this process, or of power."""
        self._flush()
        self._sync()

    def _sync(self) -> None:
        if self._durable:
            self._file.sync()

    def _fail(self, error: OSError) -> RecordingError:
        self._failure = unwritable(self.path, error)
        return self._failure


@functools.cache
def _schema(kind: type[Message] | type[JournalEntry]) -> bytes:
    return json_schema(kind)


def _entry(name: str, payload: bytes) -> JournalEntry:
    try:
        return decode_entry(payload)
    except msgspec.DecodeError as error:
        raise BadMessageError(f"{name}: {error}") from error


def _move_new(source: Path, target: Path) -> None:
    """Move a file to a path at which there is none; raises FileExistsError."""
    try:
        target.hardlink_to(source)
    except FileExistsError:
        raise
    except OSError:  # not on this file system
        if target.exists():
            raise FileExistsError from None
        source.replace(target)
    else:
        source.unlink()


def _sync_folder(folder: Path) -> None:
    """Have the names of files survive a loss of power."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _check_size(path: Path, what: str, size: int) -> None:
    if size > MAX_PAYLOAD:
        raise RecordingError(f"{path}: {what} has {size} bytes; at most {MAX_PAYLOAD} can be recorded")
