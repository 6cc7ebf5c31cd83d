"""The replay runner: nodes are fed from a recording, in journal order, and what they do is compared with what they did.

Each node gets its recorded inputs, never another node's new output. A run that was made lockstep can also be replayed
as a closed loop from its source, with settings changed.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import cv2
import msgspec
from dynpf_formats.recording.diff import first_field
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.journal import JournalEntry, encode_entry
from dynpf_protocol.topics import EVENT_PREFIX, Topic, is_compared

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan

__all__ = ["Mismatch", "Replayed", "replay_node", "write_replayed"]


class Mismatch(NamedTuple):
    """The first place where a replayed node did something else: both values, as recorded and as replayed."""

    node: str
    topic: str
    tick: int
    sequence: int
    field: str
    recorded: Any
    replayed: Any


class Replayed(NamedTuple):
    """What came of replaying one node. ``executed`` is kept only on request: boot, messages and journal
    entry of each step."""

    node: str
    steps: int
    messages: int
    digests: int
    mismatch: Mismatch | None
    executed: tuple[tuple[str, tuple[Sent, ...], JournalEntry], ...]


def replay_node(recording: Recording, plan: Plan, name: str, *, keep: bool = False) -> Replayed:
    """Feed the node ``name`` of ``plan`` what it consumed in the recorded run; compare what it does with what it did.

    Compared are messages, sequences, stamps and state digests.

    Raises UsageError if the recording has no journal of the node or lacks an input that the journal names.
    """
    cv2.setNumThreads(1)
    boots = [boot for node, boot in recording.journals() if node == name]
    if not boots:
        known = ", ".join(dict.fromkeys(node for node, _ in recording.journals())) or "none"
        raise UsageError(f"{recording.path}: holds no journal of {name}; journals: {known}")
    spec, topics = plan.graph.specs[name], plan.graph.topics
    node = spec.build()
    steps = messages = digests = 0
    first: Mismatch | None = None
    kept: list[tuple[str, tuple[Sent, ...], JournalEntry]] = []
    for boot in boots:
        executor = Executor(node, spec, topics, boot, plan.state_digest_ticks)
        for entry in recording.journal(name, boot):
            inputs = list(_inputs(recording, topics, name, entry))
            sent = executor.step(entry.tick, entry.stamp_ns, inputs, 0).sent
            anew = executor.journal(entry.tick, entry.stamp_ns, inputs, sent, last=entry.last)
            first = first or _compare(recording, name, boot, (entry, anew), sent)
            steps += 1
            messages += len(sent)
            digests += bool(entry.state)
            if keep:
                kept.append((boot, sent, anew))
    return Replayed(name, steps, messages, digests, first, tuple(kept))


def _inputs(recording: Recording, topics: Mapping[str, Topic], node: str, entry: JournalEntry) -> Iterator[Received]:
    for sender, boot, topic, sequence in (msgspec.structs.astuple(one) for one in entry.consumed):
        one = recording.find(sender, boot, topic, sequence)
        if one is None:
            raise UsageError(
                f"{recording.path}: step {entry.step} of {node} consumed {topic} {sequence} of {sender}, which the "
                "recording lacks; dynpf doctor tells what else is missing"
            )
        yield Received(topic, sender, boot, sequence, one.stamp_ns, decode(topic, one.payload, topics))


def _compare(
    recording: Recording, node: str, boot: str, entries: tuple[JournalEntry, JournalEntry], sent: Sequence[Sent]
) -> Mismatch | None:
    entry, anew = entries

    def mismatch(topic: str, sequence: int, field: str, recorded: Any, replayed: Any) -> Mismatch:
        return Mismatch(node, topic, entry.tick, sequence, field, recorded, replayed)

    old = {(one.topic, one.sequence): None for one in entry.produced if is_compared(one.topic)}
    new = {(one.topic, one.envelope.sequence): one for one in sent if is_compared(one.topic)}
    for topic, sequence in [*old, *(key for key in new if key not in old)]:
        before = recording.find(node, boot, topic, sequence) if (topic, sequence) in old else None
        after = new.get((topic, sequence))
        if before is None or after is None:
            told = ["present" if one is not None else "absent" for one in (before, after)]
            return mismatch(topic, sequence, "message", *told)
        if before.stamp_ns != after.envelope.stamp_ns:
            return mismatch(topic, sequence, "stamp_ns", before.stamp_ns, after.envelope.stamp_ns)
        if before.payload != after.payload:
            field = first_field(before.payload, after.payload) or ("bytes", before.payload, after.payload)
            return mismatch(topic, sequence, *field)
    if list(old) != list(new):
        return mismatch("", 0, "order of messages", [key[0] for key in old], [key[0] for key in new])
    if entry.state and entry.state != anew.state:
        return mismatch(f"journal/{node}", entry.step, "state", entry.state, anew.state)
    return None


def write_replayed(recording: Recording, outcomes: Sequence[Replayed], writer: RecordingWriter) -> None:
    """Write the recording anew with the output of the replayed nodes in the place of what was recorded of them.

    The gaps that the hosts of these nodes told them stay, for the nodes consumed them; what the recorder missed, the
    writer finds anew.
    """
    replayed = {outcome.node for outcome in outcomes}
    for record in recording.records:
        told = record.topic == EVENT_PREFIX + record.node
        if record.topic == "recorder/gap" or (record.node in replayed and not told):
            continue
        envelope = Envelope(
            record.node,
            record.boot,
            record.sequence,
            recording.tick_of(record) or 0,
            record.stamp_ns,
            record.publish_ns,
        )
        writer.message(record.topic, envelope, record.payload)
    for outcome in outcomes:
        for boot, sent, made in outcome.executed:
            for one in sent:
                writer.message(*one)
            envelope = Envelope(outcome.node, boot, made.step, made.tick, made.stamp_ns, 0)
            writer.journal(envelope, encode_entry(made))
