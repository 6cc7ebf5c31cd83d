"""Writes a capture: a channel for what is heard for the first time, chunks that are closed in time, and the tally."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from dynpf_protocol.printable import printable
from mcap.writer import CompressionType, Writer

from dynpf_formats.capture.form import CAPTURE, DROPPED, END, PROFILE, Began, Dropped, Ended, Origin, as_text, numbered
from dynpf_formats.capture.tally import Tally
from dynpf_formats.recording.files import PlainFile, already_there, unwritable
from dynpf_formats.recording.mcap_records import MAX_RATIO, MAX_UNPACKED
from dynpf_formats.recording.writer import MAX_PAYLOAD
from dynpf_formats.ros2.attachment import Attachment, BadAttachmentError
from dynpf_formats.ros2.keys import Published, Qos

if TYPE_CHECKING:
    from dynpf_formats.ros2.types import Releases, RosTypes  # needs rosbags

__all__ = ["CHUNK_BYTES", "MAX_PAYLOAD", "CaptureWriter", "Sample"]

CHUNK_BYTES = 2**20
"""Largest chunk, uncompressed; only a single larger message makes a larger chunk."""

MOST_CHANNELS = 10_000
_MOST_NOTICES = 50
_UNPACKED, _RATIO = MAX_UNPACKED // 2, MAX_RATIO // 2
"""Chunks hold so many bytes, and besides so many times the file's size: half of what a reader takes."""

_MESSAGE_OVERHEAD = 31  # opcode, length and fields of a message record before its payload
_CDR = b"\x00\x01"  # how a ROS message begins: little endian
_WHOLLY_CHECKED = 64 * 1024
"""Bytes of a message that is decoded to see whether it is one; of larger ones the beginning is looked at."""

_MCAP_NAMES = {
    "application/json": "json",
    "text/json": "json",
    "application/cbor": "cbor",
    "application/protobuf": "protobuf",
    "application/cdr": "cdr",
}
"""Encodings that MCAP has names of its own for, by Zenoh's."""


class Sample(NamedTuple):
    """What was heard: key, bytes, attachment (empty for none), Zenoh's encoding, and when it arrived (wall clock)."""

    key: str
    payload: bytes
    attachment: bytes
    encoding: str
    arrival_ns: int


class _Known(NamedTuple):
    """What a key is: a ROS topic if ``published`` is given; ``types`` has its type, None if that is not known."""

    published: Published | None
    types: "RosTypes | None"


class CaptureWriter:
    """Writes what is heard into the new file ``path``; raises RecordingError once that cannot be written.

    ROS topics are those of ``began.domain`` by ``releases``; None: there are none. ``qos_of`` returns what a topic's
    publishers are known to offer. ``notices`` has, in order, what a person should be told.
    """

    def __init__(
        self,
        path: Path,
        began: Began,
        releases: "Releases | None",
        qos_of: Callable[[str], Qos | None] = lambda _topic: None,
    ) -> None:
        self.path = path
        self.tally = Tally()
        self.notices: list[str] = []
        self._began, self._releases, self._qos_of = began, releases, qos_of
        self._known: dict[str, _Known] = {}
        self._channels: dict[Origin, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._dropped = 0  # the channel of Dropped, once it is there
        self._told: defaultdict[str, set[str]] = defaultdict(set)  # subjects by what is told of them
        self._pending = self._unpacked = 0  # bytes in the open chunk, and in all before it
        try:
            self._file = PlainFile(path, overwrite=False)
        except FileExistsError:
            raise already_there(path) from None
        except OSError as error:
            raise unwritable(path, error) from error
        self._mcap = Writer(self._file, chunk_size=2 * CHUNK_BYTES, enable_data_crcs=True)  # type: ignore[arg-type]
        with self._writing():
            self._mcap.start(PROFILE, f"dynpf {began.dynpf_version}")
            self._mcap.add_metadata(CAPTURE, as_text(began))

    def write(self, sample: Sample) -> None:
        """Write a message; what a ROS topic brings that is no ROS message is kept as it came, under its key."""
        attachment = self._attachment(sample)
        publisher = "" if attachment is None else attachment.publisher.hex()
        known = self._known_of(sample.key)
        if known.published is None:
            origin = Origin(sample.key, sample.encoding, sample.key, publisher)
        elif fault := self._fault(known, sample.payload):
            self._tell("fault", known.published.topic, f"{fault}; kept as it came, and later ones like it")
            what = f"no {known.published.type}"
            origin = Origin(sample.key, sample.encoding, sample.key, publisher, what)
        else:
            origin = Origin(known.published.topic, known.published.type, sample.key, publisher)
        channel = self._channels.get(origin)
        if channel is None:
            with self._writing():
                channel = self._open(origin, known)
        if channel is None:
            self._tell("channels", "all", f"more than {MOST_CHANNELS} keys and publishers; further ones are left out")
            self.drop(Dropped.of(sample.key, attachment, sample.arrival_ns))
            return
        sequence, stamp_ns = (0, sample.arrival_ns) if attachment is None else numbered(attachment)
        self._put(channel, sample.arrival_ns, sample.payload, stamp_ns, sequence)
        lost = self.tally.add(origin, sequence, stamp_ns, sample.arrival_ns, len(sample.payload))
        if lost is not None:
            numbers = str(lost.first) if lost.first == lost.last else f"{lost.first} to {lost.last}"
            self._tell(
                "lost", self.tally.topic_of(sample.key), f"message {numbers} did not come; all is told at the end"
            )

    def drop(self, dropped: Dropped) -> None:
        """Write that messages have come that there was no room for."""
        if not self._dropped:
            with self._writing():
                self._dropped = self._mcap.register_channel(DROPPED, "json", 0)
        self.tally.drop(dropped)
        self._put(self._dropped, dropped.at_ns, msgspec.json.encode(dropped), dropped.at_ns, 0)

    def flush(self) -> None:
        """Close the chunk: what is in it survives the end of this process."""
        with self._writing():
            self._mcap.flush()  # type: ignore[no-untyped-call]
        self._unpacked += self._pending
        self._pending = 0
        # A file that unpacks to much more than its size is refused by who reads it, such as a minute of black images.
        packs = self._unpacked <= _UNPACKED + _RATIO * self._file.tell()
        self._mcap._Writer__compression = CompressionType.ZSTD if packs else CompressionType.NONE  # type: ignore[attr-defined]

    def close(self, reason: str, ended_ns: int) -> Ended:
        """End the file, and return the end that was written."""
        end = self.tally.ended(reason, ended_ns, complete=True)
        self.flush()
        with self._writing():
            self._mcap.add_metadata(END, as_text(end))
            self._mcap.finish()  # type: ignore[no-untyped-call]
        self._file.close()
        return end

    def release(self) -> None:
        """Close the file as it is, unless ``close`` has; what is in its chunks can be recovered."""
        self._file.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise unwritable(self.path, error) from error

    def _attachment(self, sample: Sample) -> Attachment | None:
        """Return number, time and publisher, if the message has them; tell what else is attached."""
        if not sample.attachment:
            return None
        try:
            return Attachment.decode(sample.attachment)
        except BadAttachmentError as error:
            self._tell("attached", sample.key, f"{error}; recorded without it, and without numbers")
            return None

    def _known_of(self, key: str) -> _Known:
        known = self._known.get(key)
        if known is None:
            published = Published.parse(key) if self._releases is not None else None
            if published is not None and published.key(self._began.domain) != key:
                published = None  # of another domain
            types = None
            if published is not None and self._releases is not None:
                types = self._releases.types_of(published)
                if types is None:
                    self._tell("type", published.topic, f"no definition of {published.type} here; recorded without one")
            known = _Known(published, types)
            if len(self._known) < MOST_CHANNELS:
                self._known[key] = known
        return known

    def _fault(self, known: _Known, payload: bytes) -> str:
        """Return why bytes are no message of their topic's type, or an empty text."""
        assert known.published is not None
        if len(payload) < 4 or not payload.startswith(_CDR):
            return f"a message begins with {payload[:4].hex() or 'nothing'}; expected CDR, little endian (00010000)"
        if known.types is not None and len(payload) <= _WHOLLY_CHECKED:
            try:
                known.types.decode(known.published.type, payload)
            except ValueError as error:  # BadRosMessageError
                return str(error)
        return ""

    def _open(self, origin: Origin, known: _Known) -> int | None:
        if len(self._channels) >= MOST_CHANNELS:
            return None
        entries = origin.entries()
        published = known.published
        if published is None or origin.fault:
            name = origin.type.partition(";")[0]
            channel = self._mcap.register_channel(origin.topic, _MCAP_NAMES.get(name, origin.type), 0, entries)
        else:
            qos = self._qos_of(published.topic)
            entries["topic_type_hash"] = published.hash
            entries["offered_qos_profiles"] = "" if qos is None else qos.profile()
            channel = self._mcap.register_channel(origin.topic, "cdr", self._schema(published.type, known), entries)
        if origin.topic not in self.tally.topics:
            self._tell("topic", origin.topic, origin.type)
        self._channels[origin] = channel
        return channel

    def _schema(self, kind: str, known: _Known) -> int:
        text = "" if known.types is None else known.types.definition(kind)
        if (kind, text) not in self._schemas:
            form = "ros2msg" if text else ""
            self._schemas[kind, text] = self._mcap.register_schema(kind, form, text.encode())
        return self._schemas[kind, text]

    def _put(self, channel: int, log_ns: int, payload: bytes, publish_ns: int, sequence: int) -> None:
        size = len(payload) + _MESSAGE_OVERHEAD
        if self._pending + size > CHUNK_BYTES:
            self.flush()
        self._pending += size
        try:
            self._mcap.add_message(channel, log_ns, payload, publish_ns, sequence)
        except OSError as error:
            raise unwritable(self.path, error) from error

    def _tell(self, kind: str, subject: str, text: str) -> None:
        """Tell something once of each topic or key, and of no more than fifty of them."""
        told = self._told[kind]
        if subject not in told and len(told) < _MOST_NOTICES:
            told.add(subject)
            self.notices.append(printable(f"{subject}: {text}"))
