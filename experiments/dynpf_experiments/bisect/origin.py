"""Where the first difference of two recordings comes from: other inputs of its node, or the node itself."""

import hashlib
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any, Literal, NamedTuple

from dynpf_formats.recording.diff import FirstDifference
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry
from dynpf_protocol.topics import LOG_NODE

__all__ = ["Origin", "origin"]

_Input = tuple[str, str, int, int, str]  # node, topic, sequence, stamp in ns, digest


class Origin(NamedTuple):
    """What is known of the step that made the first message that differs.

    ``kind`` is ``source`` for a record of a log, ``end`` if one of the runs has ended before it, ``inputs`` if the node
    had read something else by then, ``node`` if it made something else of the same inputs; ``text`` says what.
    """

    kind: Literal["source", "end", "inputs", "node"]
    text: str


class _Step(NamedTuple):
    entry: JournalEntry
    inputs: tuple[_Input, ...]


def origin(a: Recording, b: Recording, first: FirstDifference) -> Origin:
    """Return where the first difference of two recordings comes from."""
    if first.node == LOG_NODE:
        return Origin("source", f"the record {first.topic} {first.sequence} of the log that the runs play is another")
    steps = (_steps(a, first.node), _steps(b, first.node))
    for number, (left, right) in enumerate(zip_longest(*steps)):
        if left is None or right is None:
            return _ended(a if left is None else b, first.node, number)
        for what, one, other in _unlike(left, right):
            return Origin("inputs", f"step {number} of {first.node}, tick {left.entry.tick}: {what}: {one} and {other}")
        if _makes(left.entry, first) or _makes(right.entry, first):
            if first.topic.startswith(JOURNAL_PREFIX) and left.entry.last != right.entry.last:
                return _ended(a if left.entry.last else b, first.node, number + 1)
            break
    return Origin("node", f"{first.node} has read the same up to there, and made something else of it")


def _ended(recording: Recording, node: str, number: int) -> Origin:
    end = recording.end
    reason = "its end was never written" if end is None else f"{end.reason} ({end.outcome})"
    return Origin("end", f"{recording.path}: {node} makes no more steps from step {number} on: {reason}")


def _steps(recording: Recording, node: str) -> Iterator[_Step]:
    for name, boot in recording.journals():
        if name == node:
            for entry in recording.journal(node, boot):
                yield _Step(entry, tuple(_inputs(recording, entry)))


def _inputs(recording: Recording, entry: JournalEntry) -> Iterator[_Input]:
    for read in entry.consumed:
        record = recording.find(read.node, read.boot, read.topic, read.sequence)
        stamp_ns, digest = (-1, "missing") if record is None else (record.stamp_ns, _digest(record.payload))
        yield read.node, read.topic, read.sequence, stamp_ns, digest


def _digest(payload: bytes) -> str:
    return hashlib.sha256(payload).hexdigest()[:12]


def _unlike(a: _Step, b: _Step) -> Iterator[tuple[str, Any, Any]]:
    """Yield what a step was given, where it differs, with both values."""
    for name in ("tick", "stamp_ns"):
        if getattr(a.entry, name) != getattr(b.entry, name):
            yield name, getattr(a.entry, name), getattr(b.entry, name)
    for index, (left, right) in enumerate(zip_longest(a.inputs, b.inputs)):
        if left != right:
            yield f"input {index}", _worded(left), _worded(right)


def _worded(read: _Input | None) -> str:
    if read is None:
        return "none"
    node, topic, sequence, stamp_ns, digest = read
    return f"{topic} {sequence} of {node} at {stamp_ns * 1e-9:.3f} s, {digest}"


def _makes(entry: JournalEntry, first: FirstDifference) -> bool:
    """Return whether a step made the message, or had the state, that differs."""
    if first.topic == JOURNAL_PREFIX + first.node:
        return entry.tick == first.tick
    made = [(one.topic, one.sequence) for one in entry.produced] + [(one.topic, one.sequence) for one in entry.hosted]
    return (first.topic, first.sequence) in made
