"""Journal: what each step of a node consumed and produced, exactly and in order.

Together with the recorded messages it has everything that a node depended on: giving a new node the messages of each
entry, in order, re-executes it.

The entries of a node are chained by digests: the chain value of an entry covers the one before it, the entry, and every
message of its step. So no entry or message can be changed, left out, put in or exchanged without changing all chain
values after it. They are written at intervals; whoever has the recording can compute those in between.
"""

import hashlib
from collections.abc import Iterable
from typing import ClassVar

import msgspec

from dynpf_protocol.numbers import Count63

__all__ = [
    "JOURNAL_PREFIX",
    "Consumed",
    "Hosted",
    "JournalEntry",
    "Produced",
    "chain_after",
    "decode_entry",
    "encode_entry",
    "genesis",
]

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


class Hosted(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to a message that the node's host published in the step: a log's record, or a report of a gap."""

    node: str
    topic: str
    sequence: Count63


class JournalEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One step. ``state`` is the SHA-256 of the node's state after it, or "" if none was taken.

    ``chain`` is the chain value after the step, in hexadecimal, wherever there is a ``state``, else "".
    """

    schema_name: ClassVar[str] = "dynpf.JournalEntry"
    step: Count63
    tick: Count63
    stamp_ns: Count63
    consumed: tuple[Consumed, ...]
    produced: tuple[Produced, ...]
    last: bool = False
    state: str = ""
    hosted: tuple[Hosted, ...] = ()
    chain: str = ""


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


def genesis(node: str, scenario: str) -> bytes:
    """Return the chain value before a node's first step, which binds it to the run's resolved scenario.

    The scenario's text holds the digests of the files that it names.
    """
    return hashlib.sha256(msgspec.json.encode(["dynpf journal", node, scenario])).digest()


def chain_after(previous: bytes, boot: str, entry: JournalEntry, messages: Iterable[tuple[int, bytes]]) -> bytes:
    """Return the chain value after a step: a SHA-256.

    ``messages`` are the logical stamp (ns) and the payload of each message of the step: the hosted ones, then the
    produced ones, in the order of the entry. The entry is taken without its own chain value.
    """
    unchained = msgspec.structs.replace(entry, chain="") if entry.chain else entry
    chain = hashlib.sha256(previous)
    chain.update(msgspec.json.encode([boot, unchained]))
    for stamp_ns, payload in messages:
        chain.update(stamp_ns.to_bytes(8, "little"))
        chain.update(hashlib.sha256(payload).digest())
    return chain.digest()
