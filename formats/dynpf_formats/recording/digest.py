"""What counts as "the same run", as data: the compared messages and the states of the nodes, and a digest over them.

Compared, per node and topic, by sequence: payload bytes, tick and logical stamp; and the state digests of the journals.
Left out: boots (a node's starts are numbered in their order), publish times, topics that are not compared, the layout
of file and journal.
"""

import hashlib
from typing import NamedTuple

import msgspec
from dynpf_protocol.topics import is_compared

from dynpf_formats.recording.reader import Recorded, Recording

__all__ = ["Key", "Leaf", "StateKey", "content_digest", "leaves", "starts", "states"]


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
    for key, leaf in sorted(leaves(recording).items()):
        total.update(msgspec.json.encode((*key, leaf.tick, leaf.stamp_ns, leaf.digest.hex())) + b"\n")
    for state in sorted(states(recording).items()):
        total.update(msgspec.json.encode(state) + b"\n")
    return total.hexdigest()


def leaves(recording: Recording) -> dict[Key, Leaf]:
    """Return what is compared of every compared message."""
    numbers = starts(recording)
    found = {}
    for record in recording.messages():
        if not is_compared(record.topic):
            continue
        tick = recording.tick_of(record)
        key = Key(record.node, record.topic, numbers[record.node, record.boot], record.sequence)
        found[key] = Leaf(
            -1 if tick is None else tick, record.stamp_ns, hashlib.sha256(record.payload).digest(), record
        )
    return found


def states(recording: Recording) -> dict[StateKey, tuple[int, str]]:
    """Return (tick, state digest) of every state that a journal tells."""
    numbers = starts(recording)
    found = {}
    for node, boot in recording.journals():
        told = ((entry.tick, entry.state) for entry in recording.journal(node, boot) if entry.state)
        found.update({StateKey(node, numbers[node, boot], number): state for number, state in enumerate(told)})
    return found


def starts(recording: Recording) -> dict[tuple[str, str], int]:
    """Return the place of each boot among the starts of its node."""
    nodes = {source.node for source in recording.sources}
    return {(node, boot): start for node in nodes for start, boot in enumerate(recording.boots(node))}
