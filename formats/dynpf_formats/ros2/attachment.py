"""The attachment of a ROS 2 message on Zenoh: its number, its time and who publishes it; and the losses it shows.

33 bytes: number and time (ns) as little-endian int64, the length 16, and 16 bytes that name the publisher. Source:
ros2/rmw_zenoh, attachment_helpers.cpp.
"""

import struct
from collections import OrderedDict
from typing import NamedTuple

from dynpf_formats.ros2.xxh3 import xxh3_128

__all__ = ["Attachment", "BadAttachmentError", "Lost", "Numbers", "publisher_id"]

_FORM = struct.Struct("<qqB16s")
_NAMES = b"sequence_number"  # of the fields, until April 2025
_MOST_PUBLISHERS = 256


class BadAttachmentError(ValueError):
    """An attachment that is none of ROS 2, or is that of an old version."""


class Attachment(NamedTuple):
    """The number of a message among its publisher's, when it was published (ns, wall clock), and by whom.

    Of rmw_zenoh the first has the number 1; others begin at 0.
    """

    sequence: int
    stamp_ns: int
    publisher: bytes

    def encode(self) -> bytes:
        """Return the 33 bytes."""
        return _FORM.pack(self.sequence, self.stamp_ns, len(self.publisher), self.publisher)

    @classmethod
    def decode(cls, data: bytes) -> "Attachment":
        """Return what the bytes say; raises BadAttachmentError."""
        if _NAMES in data:
            raise BadAttachmentError(
                "an attachment of rmw_zenoh before April 2025 (jazzy 0.2.4, rolling 0.6.0); update it on the robot"
            )
        if len(data) != _FORM.size or data[16] != 16:
            raise BadAttachmentError(f"an attachment of {len(data)} bytes; expected the {_FORM.size} of rmw_zenoh")
        sequence, stamp_ns, _, publisher = _FORM.unpack(data)
        if sequence < 0:
            raise BadAttachmentError(f"the message number {sequence}; expected 0 or more")
        return cls(sequence, stamp_ns, publisher)

    @classmethod
    def found(cls, data: bytes) -> "Attachment | None":
        """Return what the bytes say, None if they are none of ROS 2."""
        try:
            return cls.decode(data)
        except BadAttachmentError:
            return None


class Lost(NamedTuple):
    """The numbers of messages that never came."""

    first: int
    last: int


class Numbers:
    """The numbers that have come on one topic, of each publisher. The first that comes is the beginning."""

    def __init__(self) -> None:
        self._next: OrderedDict[bytes, int] = OrderedDict()

    def see(self, attachment: Attachment) -> Lost | None:
        """Note a message; return those that were lost before it.

        Raises BadAttachmentError for one that has come before, or is late.
        """
        number, publisher, _ = attachment.sequence, attachment.publisher, attachment.stamp_ns
        expected = self._next.get(publisher, number)
        if number < expected:
            raise BadAttachmentError(f"the message number {number} again, or late; expected {expected} or more")
        self._next[publisher] = number + 1
        self._next.move_to_end(publisher)
        if len(self._next) > _MOST_PUBLISHERS:
            self._next.popitem(last=False)
        return Lost(expected, number - 1) if number > expected else None


def publisher_id(token: str) -> bytes:
    """Return the 16 bytes that name a publisher: the hash of its token, as ``ros2 topic info`` has it."""
    return xxh3_128(token.encode()).to_bytes(16, "little")
