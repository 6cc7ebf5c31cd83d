"""Journal: what each step of a node consumed and produced, exactly and in order.

Together with the recorded messages it has everything that a node depended on: giving a new node the messages of each
entry, in order, re-executes it.
"""

from typing import ClassVar

import msgspec

from dynpf_protocol.numbers import Count63

__all__ = ["JOURNAL_PREFIX", "Consumed", "JournalEntry", "Produced", "decode_entry", "encode_entry"]

JOURNAL_PREFIX = "journal/"
"""The journal of node NAME is recorded on topic journal/NAME."""


class Consumed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to one input message."""

    node: str
    boot: str
    topic: str
    sequence: Count63


class Produced(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to one output message of the step's own node and boot."""

    topic: str
    sequence: Count63


class JournalEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One step. ``state`` is the SHA-256 of the node's state after it, or "" if none was taken."""

    schema_name: ClassVar[str] = "dynpf.JournalEntry"
    step: Count63
    tick: Count63
    stamp_ns: Count63
    consumed: tuple[Consumed, ...]
    produced: tuple[Produced, ...]
    last: bool = False
    state: str = ""


_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(JournalEntry)


def encode_entry(entry: JournalEntry) -> bytes:
    """Return the entry as a payload."""
    return _ENCODER.encode(entry)


def decode_entry(payload: bytes) -> JournalEntry:
    """Return the entry in ``payload``; raises msgspec.DecodeError."""
    try:
        return _DECODER.decode(payload)
    except (UnicodeDecodeError, RecursionError) as error:
        raise msgspec.DecodeError(str(error)) from error
