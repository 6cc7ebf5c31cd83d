"""The form of a capture: which metadata an MCAP file has beside what other tools read, and how a channel says who sent.

A capture has the profile ``ros2``. Each publisher of a ROS topic has a channel, with type and messages as rosbag2 has
them; other keys are channels without a schema. A message's sequence is its publisher's number modulo 2**32, its log
time when it arrived, its publish time when it was published, both by the wall clocks.
"""

from typing import Annotated, NamedTuple, TypeVar

import msgspec
from dynpf_protocol.json_text import read_json

from dynpf_formats.recording.header import checksum
from dynpf_formats.ros2.attachment import Attachment, Lost

__all__ = [
    "CAPTURE",
    "DROPPED",
    "END",
    "PROFILE",
    "Began",
    "Dropped",
    "Ended",
    "Origin",
    "Outage",
    "as_text",
    "numbered",
    "read",
]

PROFILE = "ros2"
CAPTURE, END = "dynpf_capture", "dynpf_capture_end"
"""The names of the metadata at the beginning and at the end."""

DROPPED = "dynpf/dropped"
"""The topic on which a capture tells what its recorder had no room for: Dropped as JSON."""

LATEST_NS = 2**63 - 1
_Count = Annotated[int, msgspec.Meta(ge=0, le=LATEST_NS)]
_CONTENT, _CHECKSUM = "content", "sha256"
_WRAP = 2**32
_LONGEST = 2000  # characters of a key or a type


class Origin(NamedTuple):
    """What is the same for all messages of a channel.

    ``type`` is a ROS type, or Zenoh's encoding; ``key`` is Zenoh's; ``publisher`` is 32 hexadecimal digits, or empty
    where messages have no numbers. ``fault`` is why messages on a ROS topic are no ROS messages; they are kept as they
    came, on the topic of their key.
    """

    topic: str
    type: str
    key: str
    publisher: str = ""
    fault: str = ""

    def entries(self) -> dict[str, str]:
        """Return the metadata of the channel."""
        named = {"dynpf_type": self.type, "dynpf_key": self.key}
        return named | {f"dynpf_{name}": value for name in ("publisher", "fault") if (value := getattr(self, name))}

    @classmethod
    def of(cls, topic: str, entries: dict[str, str]) -> "Origin | None":
        """Return what a channel's metadata say, None if it is no channel of a key."""
        if "dynpf_key" not in entries or "dynpf_type" not in entries:
            return None
        values = [entries.get(f"dynpf_{name}", "") for name in ("type", "key", "publisher", "fault")]
        return cls(topic, *(value[:_LONGEST] for value in values))


class Dropped(msgspec.Struct, frozen=True, kw_only=True):
    """Messages of one publisher, one after another, that came and that the recorder had no room for.

    Where messages have no numbers, ``publisher`` is empty, and ``count`` is all that is known.
    """

    key: str
    publisher: str
    count: _Count
    at_ns: _Count  # when the last arrived
    first: _Count = 0  # number, as an MCAP file has it
    last: _Count = 0
    stamp_ns: _Count = 0  # when the last was published

    @classmethod
    def of(cls, key: str, attachment: Attachment | None, arrival_ns: int) -> "Dropped":
        """Return what is to be said of one message."""
        if attachment is None:
            return cls(key=key, publisher="", count=1, at_ns=arrival_ns)
        number, stamp_ns = numbered(attachment)
        publisher = attachment.publisher.hex()
        return cls(
            key=key, publisher=publisher, count=1, at_ns=arrival_ns, first=number, last=number, stamp_ns=stamp_ns
        )

    def with_next(self, after: "Dropped") -> "Dropped | None":
        """Return this and the publisher's next messages as one, None if their numbers do not follow these."""
        if self.publisher and after.first != (self.last + 1) % _WRAP:
            return None
        count, stamp_ns = self.count + after.count, max(self.stamp_ns, after.stamp_ns)
        return msgspec.structs.replace(self, count=count, last=after.last, at_ns=after.at_ns, stamp_ns=stamp_ns)


def numbered(attachment: Attachment) -> tuple[int, int]:
    """Return number and time of a message as an MCAP file can hold them."""
    return attachment.sequence % _WRAP, max(attachment.stamp_ns, 0)


class Outage(NamedTuple):
    """A time without a router, by the wall clock of the recorder, ns; ``until_ns`` is 0 if it did not come back."""

    since_ns: _Count
    until_ns: _Count


class Loss(NamedTuple):
    """What went wrong with the messages of a publisher; ``ranges`` are the first numbers that never came."""

    topic: str
    publisher: str
    missing: int
    dropped: int
    duplicates: int
    late: int
    ranges: tuple[Lost, ...]


class Began(msgspec.Struct, frozen=True, kw_only=True):
    """What was to be heard."""

    dynpf_version: str
    connect: str
    keys: tuple[str, ...]
    domain: _Count
    format: str
    began_ns: _Count  # wall clock


class Ended(msgspec.Struct, frozen=True, kw_only=True):
    """How it ended, by the recorder or by who mended the file, and what the recorder counted."""

    reason: str
    complete: bool
    ended_ns: _Count
    messages: _Count
    missing: _Count
    dropped: _Count
    outages: tuple[Outage, ...] = ()
    losses: tuple[Loss, ...] = ()


_T = TypeVar("_T", Began, Ended)


def as_text(record: Began | Ended) -> dict[str, str]:
    """Return the entries of a metadata record."""
    entries = {_CONTENT: msgspec.json.encode(record).decode()}
    return entries | {_CHECKSUM: checksum(entries)}


def read(entries: dict[str, str], kind: type[_T]) -> _T | None:
    """Return what a metadata record says, None if it is damaged."""
    content = entries.get(_CONTENT, "")
    if entries.get(_CHECKSUM) != checksum({_CONTENT: content}):
        return None
    try:
        return read_json(content, kind)
    except msgspec.DecodeError:
        return None
