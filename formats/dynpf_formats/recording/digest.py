"""What counts as "the same run", as data: the compared messages and the states of the nodes, and a digest over them.

Compared, per node and topic, by sequence: payload bytes, tick and logical stamp; and the state digests of the journals.
Left out: boots (a node's starts are numbered in their order), publish times, topics that are not compared, the layout
of file and journal.
"""

import hashlib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.topics import is_compared

from dynpf_formats.recording.reader import Recorded, Recording, Source

__all__ = ["Key", "Leaf", "StateKey", "content_digest", "leaves", "starts", "states"]

_DIGEST_BYTES = 32


class Key(NamedTuple):
    """Which message; ``start`` numbers the starts of the node's process from 0."""

    node: str
    topic: str
    start: int
    sequence: int


class Leaf(NamedTuple):
    """What is compared of a message; ``tick`` is -1 where no journal tells it."""

    tick: int
    stamp_ns: int
    digest: bytes  # SHA-256 of the payload
    record: Recorded


class StateKey(NamedTuple):
    """Which state: the ``number``-th digest in the journal of a node's start."""

    node: str
    start: int
    number: int


def content_digest(recording: Recording) -> str:
    """Return the SHA-256, in hexadecimal, over what is compared of a recording."""
    total = hashlib.sha256()
    numbers = starts(recording)
    digests = _payload_digests(recording)  # made in the order of the file, in which chunks are read once
    for source in sorted(filter(_is_compared, recording.sources), key=lambda source: _order(source, numbers)):
        start = numbers[source.node, source.boot]
        for record in recording.of(source):
            digest = digests[_DIGEST_BYTES * record.place : _DIGEST_BYTES * (record.place + 1)].hex()
            tick = recording.tick_of(record)
            line = (source.node, source.topic, start, record.sequence, _number(tick), record.stamp_ns, digest)
            total.update(msgspec.json.encode(line) + b"\n")
    for node, boot in sorted(recording.journals(), key=lambda start: (start[0], numbers[start])):
        for state in _states(recording, node, boot, numbers[node, boot]):
            total.update(msgspec.json.encode(state) + b"\n")
    return total.hexdigest()


def leaves(recording: Recording) -> dict[Key, Leaf]:
    """Return what is compared of every compared message."""
    numbers = starts(recording)
    found = {}
    for record in recording.messages():
        if not _is_compared(record.source):
            continue
        key = Key(record.node, record.topic, numbers[record.node, record.boot], record.sequence)
        found[key] = Leaf(
            _number(recording.tick_of(record)), record.stamp_ns, hashlib.sha256(record.payload).digest(), record
        )
    return found


def states(recording: Recording) -> dict[StateKey, tuple[int, str]]:
    """Return (tick, state digest) of every state that a journal tells."""
    numbers = starts(recording)
    found: dict[StateKey, tuple[int, str]] = {}
    for node, boot in recording.journals():
        found.update(_states(recording, node, boot, numbers[node, boot]))
    return found


def starts(recording: Recording) -> dict[tuple[str, str], int]:
    """Return the place of each boot among the starts of its node."""
    nodes = {source.node for source in recording.sources}
    return {(node, boot): start for node in nodes for start, boot in enumerate(recording.boots(node))}


def _is_compared(source: Source) -> bool:
    return not source.topic.startswith(JOURNAL_PREFIX) and is_compared(source.topic)


def _order(source: Source, numbers: Mapping[tuple[str, str], int]) -> tuple[str, str, int]:
    return source.node, source.topic, numbers[source.node, source.boot]


def _payload_digests(recording: Recording) -> bytearray:
    """Return the SHA-256 of every compared payload, at the message's place in the file."""
    digests = bytearray(_DIGEST_BYTES * len(recording.records))
    for record in recording.messages():
        if _is_compared(record.source):
            begin = _DIGEST_BYTES * record.place
            digests[begin : begin + _DIGEST_BYTES] = hashlib.sha256(record.payload).digest()
    return digests


def _states(recording: Recording, node: str, boot: str, start: int) -> Iterator[tuple[StateKey, tuple[int, str]]]:
    """Yield (tick, state digest) of every state in one journal, in order."""
    number = 0
    for entry in recording.journal(node, boot):
        if entry.state:
            yield StateKey(node, start, number), (entry.tick, entry.state)
            number += 1


def _number(tick: int | None) -> int:
    return -1 if tick is None else tick
