"""Snapshots: all that a node and its host need to go on from a step as if they had never stopped, as bytes.

What has been sent to the node and not consumed yet is not in them: the run's messages are, by the sequence numbers that
come next. A snapshot is data alone, and its reader compares the state with its digest in the journal.
"""

import hashlib

import msgspec
import zstandard

from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.numbers import Count63

__all__ = ["MOST_STATE", "SNAPSHOT_PREFIX", "Expected", "Frozen", "FrozenInbox", "Held", "Seen", "pack", "unpack"]

SNAPSHOT_PREFIX = "snapshot/"
"""The host of node NODE publishes snapshots of it on snapshot/NODE."""

MOST_STATE = 64 * 2**20
"""The largest snapshot, uncompressed, in bytes; of larger nodes there are none."""

_LEVEL = 1  # of zstd: states hardly become smaller by higher ones


class Expected(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The sequence number that a node's host expects next of a sender on a topic; a higher one makes a gap."""

    topic: str
    node: str
    sequence: Count63


class Held(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A message that a faulty link delays: due at a logical time in lockstep, after a duration in realtime."""

    due_ns: Count63
    topic: str
    node: str
    boot: str
    sequence: Count63
    stamp_ns: Count63
    payload: bytes


class Seen(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The numbers that have come of a sender's messages on a topic: all below ``next`` but those in ``open``."""

    node: str
    topic: str
    next: Count63
    open: tuple[Count63, ...]


class FrozenInbox(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An inbox between two steps, without the messages that it holds for the next ones."""

    tick: Count63  # of the next step
    next: dict[str, Count63] = {}  # lockstep: topic -> sequence number of the first message not consumed
    held: tuple[Held, ...] = ()
    stamp_ns: Count63 = 0  # realtime: of the last step
    seen: tuple[Seen, ...] = ()  # realtime
    ends: dict[str, Count63] = {}  # realtime: node -> ticks that it has ended
    running: tuple[str, ...] = ()  # realtime: the nodes upstream that have not made their last step


class Frozen(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A node and its host after a step."""

    sequences: dict[str, Count63]  # topic -> sequence number of the next message, but of reports by the wall clock
    expected: tuple[Expected, ...]
    inbox: FrozenInbox
    state: bytes  # the node's own, encoded

    @property
    def digest(self) -> str:
        """The SHA-256 of the node's state, in hexadecimal, as the journal has it."""
        return hashlib.sha256(self.state).hexdigest()


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
_DECODER = msgspec.msgpack.Decoder(Frozen)


def pack(frozen: Frozen) -> bytes | None:
    """Return what was frozen as compressed bytes, or None if it is too large to be read again."""
    data = _ENCODER.encode(frozen)
    return zstandard.ZstdCompressor(level=_LEVEL).compress(data) if len(data) <= MOST_STATE else None


def unpack(data: bytes) -> Frozen:
    """Return what was frozen; raises BadMessageError for what ``pack`` does not write."""
    try:
        # zstandard allocates the size that the frame claims: check it first.
        claimed = zstandard.get_frame_parameters(data).content_size
        if not 0 < claimed <= MOST_STATE:
            raise BadMessageError(f"a snapshot that claims {claimed} bytes uncompressed; expected 1 to {MOST_STATE}")
        plain = zstandard.ZstdDecompressor().decompress(data, max_output_size=claimed, allow_extra_data=False)
        return _DECODER.decode(plain)
    except (zstandard.ZstdError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(f"an unreadable snapshot: {error}") from error
