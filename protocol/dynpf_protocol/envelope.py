"""Envelope: a message's sender, sequence number and times.

It is the attachment of a Zenoh sample; in a recording its fields are those of MCAP's channels and messages.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf_protocol.errors import BadEnvelopeError

__all__ = ["Envelope", "decode_envelope", "encode_envelope"]

_MAX = 2**63 - 1


class Envelope(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Sender, sequence number and times of one message."""

    node: Annotated[str, Meta(min_length=1, max_length=64)]
    boot: Annotated[str, Meta(min_length=1, max_length=64)]  # one start of the sender's process
    sequence: Annotated[int, Meta(ge=0, lt=2**32)]  # per topic and boot, from 0
    tick: Annotated[int, Meta(ge=0, le=_MAX)]
    stamp_ns: Annotated[int, Meta(ge=0, le=_MAX)]  # logical time
    publish_ns: Annotated[int, Meta(ge=0, le=_MAX)]  # wall clock


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(Envelope)
_MOST_BYTES = 1024


def encode_envelope(envelope: Envelope) -> bytes:
    """Return the envelope as bytes."""
    return _ENCODER.encode(envelope)


def decode_envelope(data: bytes) -> Envelope:
    """Return the envelope in ``data``; raises BadEnvelopeError."""
    if len(data) > _MOST_BYTES:
        raise BadEnvelopeError(f"unreadable envelope: {len(data)} bytes; at most {_MOST_BYTES} are allowed")
    try:
        return _DECODER.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadEnvelopeError(f"unreadable envelope: {error}") from error
