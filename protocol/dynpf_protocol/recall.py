"""Recall: how a process that is started again in mid-run asks the recorder for what its predecessor has read."""

from typing import TypeVar

import msgspec

from dynpf_protocol.control import Name, Text
from dynpf_protocol.errors import BadMessageError, TooLargeError
from dynpf_protocol.numbers import Count63

__all__ = ["Piece", "Recall", "Recalled", "decode_piece", "decode_recall", "decode_recalled", "encode_recall"]

_MOST_ASKED = 1024
_MOST_BYTES = 28 * 2**20  # the largest message of a topic, and a piece of others; less than the bus takes


class Recall(msgspec.Struct, frozen=True, array_like=True):
    """A node's new start asks for what it reads, from a tick on."""

    node: Name
    start: Name
    tick: Count63


class Piece(msgspec.Struct, frozen=True, array_like=True):
    """A message, as it was published."""

    key: str
    payload: bytes
    attachment: bytes


class Recalled(msgspec.Struct, frozen=True, array_like=True):
    """The recorder's answer: what the node reads of the ticks from ``tick`` to before ``next_tick``.

    ``written`` steps of the node are recorded; of ``said`` steps it has said that they have ended, and that ``last``
    was its last one. ``entries`` has digests of the journal entries of its steps ``tick`` and following, by which it
    knows whether it does the same again. ``snapshot`` is a message of its predecessor's host, or empty; the node goes
    on from that, and asks from ``next_tick`` on.

    In realtime ``pieces`` has for each step what it has read, and then its journal entry; ``entries`` is empty.
    """

    start: Name  # of the recorder
    to: Name  # the start that has asked
    tick: Count63
    next_tick: Count63
    more: bool  # whether the recorder has more
    lacking: Text  # why the node cannot come back, or empty
    written: Count63
    said: Count63
    last: Count63 | None
    stop_reason: Text  # not empty if the run has been asked to stop
    sequences: dict[str, Count63]  # the next number on each topic that the node's host writes at any time
    entries: tuple[bytes, ...]
    pieces: tuple[Piece, ...]
    snapshot: bytes = b""


_Kind = TypeVar("_Kind", Recall, Recalled, Piece)

_ENCODER = msgspec.msgpack.Encoder()
_RECALL = msgspec.msgpack.Decoder(Recall)
_RECALLED = msgspec.msgpack.Decoder(Recalled)
_PIECE = msgspec.msgpack.Decoder(Piece)


def encode_recall(message: Recall | Recalled | Piece) -> bytes:
    """Return the message as bytes."""
    return _ENCODER.encode(message)


def decode_recall(data: bytes) -> Recall:
    """Return what a node asks for; raises BadMessageError, and TooLargeError before it is read."""
    return _decoded(data, _RECALL, _MOST_ASKED)


def decode_recalled(data: bytes) -> Recalled:
    """Return the recorder's answer; raises BadMessageError, and TooLargeError before it is read."""
    return _decoded(data, _RECALLED, _MOST_BYTES)


def decode_piece(data: bytes) -> Piece:
    """Return what a node says again; raises BadMessageError, and TooLargeError before it is read."""
    return _decoded(data, _PIECE, _MOST_BYTES)


def _decoded(data: bytes, decoder: msgspec.msgpack.Decoder[_Kind], most: int) -> _Kind:
    if len(data) > most:
        raise TooLargeError(f"{len(data)} bytes; at most {most} are allowed")
    try:
        return decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessageError(str(error)) from error
