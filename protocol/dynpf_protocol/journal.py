"""Journal: what each step of a node consumed and produced, exactly and in order.

With the recorded messages it says all that a node's life depended on: feeding the references of each entry to a fresh
node, in order, re-executes it.
"""

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

__all__ = ["JOURNAL_PREFIX", "Consumed", "JournalEntry", "Produced", "decode_entry", "encode_entry"]

JOURNAL_PREFIX = "journal/"
"""The journal of node NAME is recorded on topic journal/NAME."""


Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class Consumed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to one input message."""

    node: str
    boot: str
    topic: str
    sequence: Count


class Produced(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to one output message of the step's own node and boot."""

    topic: str
    sequence: Count


class JournalEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One step. ``state`` is the SHA-256 of the node's state after it, or "" where none was taken."""

    schema_name: ClassVar[str] = "dynpf.JournalEntry"
    step: Count
    tick: Count
    stamp_ns: Count
    consumed: tuple[Consumed, ...]
    produced: tuple[Produced, ...]
    last: bool = False
    state: str = ""


_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(JournalEntry)


def encode_entry(entry: JournalEntry) -> bytes:
    return _ENCODER.encode(entry)


def decode_entry(payload: bytes) -> JournalEntry:
    """Return the entry in ``payload``; raises msgspec.DecodeError."""
    try:
        return _DECODER.decode(payload)
    except (UnicodeDecodeError, RecursionError) as error:
        raise msgspec.DecodeError(str(error)) from error
