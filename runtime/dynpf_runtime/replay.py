"""The replay runner: executes nodes again on their recorded inputs, in journal order, and compares the results.

Each node gets its recorded inputs, never another node's new output.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import cv2
from dynpf_formats.recording.diff import first_field
from dynpf_formats.recording.journals import messages_of
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.seek import Moment, Origin
from dynpf_formats.recording.stream import Source
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Outcome
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import UsageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, chain_after, decode_entry, encode_entry, genesis
from dynpf_protocol.topics import EVENT_PREFIX, Topic, is_compared
from msgspec.structs import replace

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.node import Node, Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.progress import Share
from dynpf_runtime.snapshot import thaw_executor

__all__ = [
    "Find",
    "Mismatch",
    "MissingMessageError",
    "Replayed",
    "Said",
    "Span",
    "compare_step",
    "replay_node",
    "write_replayed",
]


class Mismatch(NamedTuple):
    """The first difference between a replayed node and its recording, with both values."""

    node: str
    topic: str
    tick: int
    sequence: int
    field: str
    recorded: Any
    replayed: Any


class Said(Protocol):
    """A message as its node has said it."""

    @property
    def stamp_ns(self) -> int:
        """The logical time, ns."""

    @property
    def payload(self) -> bytes:
        """The bytes that travelled."""


Find = Callable[[str, int], Said | None]
"""Returns a node's message by its topic and sequence, or None."""


class MissingMessageError(UsageError):
    """The recording, or the part of it that was read, lacks a message that the journal names."""


class Span(NamedTuple):
    """A part of a run: where execution goes on from, and the first and the last moment that count."""

    origin: Origin | None = None  # None: the node's first step
    first: Moment | None = None
    last: Moment | None = None


_WHOLE = Span()


class Replayed(NamedTuple):
    """The result of replaying one node; steps, messages and digests are those of the span.

    ``duration_ns`` is the logical time from the first step that was executed to the last one.

    ``executed`` has boot, messages and journal entry of each step, if ``replay_node`` was asked to keep them.
    """

    node: str
    steps: int
    messages: int
    digests: int
    duration_ns: int
    mismatch: Mismatch | None
    executed: tuple[tuple[str, tuple[Sent, ...], JournalEntry], ...]


def replay_node(
    recording: Recording,
    plan: Plan,
    name: str,
    *,
    keep: bool = False,
    span: Span = _WHOLE,
    observe: Callable[[Node, JournalEntry], None] = lambda *_: None,
) -> Replayed:
    """Replay the node ``name`` of ``plan`` on its recorded inputs, and compare the results with the recorded ones.

    The comparison covers messages, sequence numbers, stamps, state digests, and whether and why a step was the last.
    ``observe`` is shown the node after each step.

    Raises UsageError if the recording has no journal of the node, MissingMessageError if it lacks an input that the
    journal names, BadMessageError if the snapshot of the span is none of the node.
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
    stamps: list[int] = []
    kept: list[tuple[str, tuple[Sent, ...], JournalEntry]] = []
    for boot in boots if span.origin is None else boots[boots.index(span.origin.boot) :]:
        executor = Executor(node, spec, topics, boot, plan.state_digest_ticks)
        for entry in _shown(_entries(recording, executor, span), recording, name, boot):
            inputs = list(_inputs(recording, topics, name, entry))
            sent, finished = executor.step(entry.tick, entry.stamp_ns, inputs, 0)
            observe(node, entry)
            last = entry.last or finished
            # The host's work is not repeated.
            again = executor.unchained(entry.tick, entry.stamp_ns, inputs, sent, hosted=entry.hosted, last=last)
            find = partial(recording.find, name, boot)
            if first is None and not _are_same(find, (entry, again), sent):
                first = compare_step(find, name, (entry, again), sent)
            stamps = [*stamps[:1], entry.stamp_ns]
            if span.first is None or not span.first.after(entry):
                steps += 1
                messages += len(sent)
                digests += bool(entry.state)
            if keep:
                kept.append((boot, sent, again))
            if name == plan.graph.source and last:
                first = first or _compare_outcome(recording, plan, entry, finished=finished)
    duration_ns = stamps[-1] - stamps[0] if stamps else 0
    return Replayed(name, steps, messages, digests, duration_ns, first, tuple(kept))


def _shown(entries: Iterator[JournalEntry], recording: Recording, name: str, boot: str) -> Iterator[JournalEntry]:
    """Yield the entries, showing how many of those of the node's boot are executed."""
    with Share(len(recording.of(Source(JOURNAL_PREFIX + name, name, boot))), f"steps of {name}") as progress:
        for done, entry in enumerate(entries):
            progress.show(done)
            yield entry


def _entries(recording: Recording, executor: Executor, span: Span) -> Iterator[JournalEntry]:
    """Yield the entries of the executor's boot that it has to execute, after it went on from the snapshot, if any."""
    origin, name, boot = span.origin, executor.spec.name, executor.boot
    if origin is not None and origin.boot == boot:
        thaw_executor(origin.snapshot, executor)
    for entry in recording.journal(name, boot):
        if span.last is not None and span.last.before(entry):
            return
        if span is not _WHOLE and entry.step > executor.steps:
            raise MissingMessageError(f"{recording.path}: step {executor.steps} of {name} is lacking")
        if entry.step >= executor.steps or origin is None:
            yield entry


def _inputs(recording: Recording, topics: Mapping[str, Topic], node: str, entry: JournalEntry) -> Iterator[Received]:
    for consumed in entry.consumed:
        sender, boot, topic, sequence = consumed.node, consumed.boot, consumed.topic, consumed.sequence
        record = recording.find(sender, boot, topic, sequence)
        if record is None:
            raise MissingMessageError(
                f"{recording.path}: step {entry.step} of {node} consumed {topic} {sequence} of {sender}, which the "
                "recording lacks; dynpf doctor lists what else is missing"
            )
        yield Received(topic, sender, boot, sequence, record.stamp_ns, decode(topic, record.payload, topics))


def _are_same(find: Find, entries: tuple[JournalEntry, JournalEntry], sent: Sequence[Sent]) -> bool:
    """Return whether ``compare_step`` would surely find no difference; this is faster."""
    entry, again = entries
    if entry.produced != again.produced or (entry.step, entry.state, entry.last) != (
        again.step,
        again.state,
        again.last,
    ):
        return False
    for topic, envelope, payload in sent:
        if is_compared(topic):
            record = find(topic, envelope.sequence)
            if record is None or record.stamp_ns != envelope.stamp_ns or record.payload != payload:
                return False
    return True


def compare_step(
    find: Find, node: str, entries: tuple[JournalEntry, JournalEntry], sent: Sequence[Sent]
) -> Mismatch | None:
    """Return the first difference of a step that was executed again, or None.

    ``find`` returns what the node has said, ``entries`` are the step's journal entry and that of its new execution,
    ``sent`` is what that one sent.
    """
    entry, replayed_entry = entries

    def mismatch(topic: str, sequence: int, field: str, recorded: Any, replayed: Any) -> Mismatch:
        return Mismatch(node, topic, entry.tick, sequence, field, recorded, replayed)

    old = {(produced.topic, produced.sequence): None for produced in entry.produced if is_compared(produced.topic)}
    new = {(message.topic, message.envelope.sequence): message for message in sent if is_compared(message.topic)}
    for topic, sequence in [*old, *(key for key in new if key not in old)]:
        before = find(topic, sequence) if (topic, sequence) in old else None
        after = new.get((topic, sequence))
        if before is None or after is None:
            presence = ["present" if message is not None else "absent" for message in (before, after)]
            return mismatch(topic, sequence, "message", *presence)
        if before.stamp_ns != after.envelope.stamp_ns:
            return mismatch(topic, sequence, "stamp_ns", before.stamp_ns, after.envelope.stamp_ns)
        if before.payload != after.payload:
            field = first_field(before.payload, after.payload) or ("bytes", before.payload, after.payload)
            return mismatch(topic, sequence, *field)
    before_topics, after_topics = [made.topic for made in entry.produced], [message.topic for message in sent]
    if list(old) != list(new) or before_topics != after_topics:  # topics that are not compared have a place, too
        return mismatch("", 0, "order of messages", before_topics, after_topics)
    for name in ("step", "state", "last"):
        recorded, replayed = getattr(entry, name), getattr(replayed_entry, name)
        if recorded != replayed:
            return mismatch(f"journal/{node}", entry.step, name, recorded, replayed)
    return None


def _compare_outcome(recording: Recording, plan: Plan, entry: JournalEntry, *, finished: bool) -> Mismatch | None:
    """Return the difference if the run did not end with the source's last step, ``entry``, for the reason that it says.

    Whether somebody stopped a run, or its log was over, is no node's work: the end's word is taken for it.
    """
    if recording.end is None or not recording.end.complete:
        return None
    possible = [Outcome.DONE] if finished else [Outcome.STOPPED]
    if not finished and (plan.plays_log or entry.tick + 1 == plan.max_ticks):
        possible.append(Outcome.BUDGET)
    if recording.end.outcome in possible:
        return None
    source = plan.graph.source
    return Mismatch(
        source, JOURNAL_PREFIX + source, entry.tick, entry.step, "outcome", recording.end.outcome, possible[-1].value
    )


def write_replayed(recording: Recording, outcomes: Sequence[Replayed], writer: RecordingWriter) -> None:
    """Write a copy of the recording in which the output of the replayed nodes replaces their recorded output.

    Gap events of these nodes' hosts stay, because the nodes consumed them. The writer finds the recorder's gaps again.
    The journals are chained anew, because they belong to the writer's scenario.
    """
    replayed = {outcome.node for outcome in outcomes}
    chains: dict[str, bytes] = {}
    for record in recording.records:
        is_host_event = record.topic == EVENT_PREFIX + record.node
        if record.topic in ("recorder/gap", "recorder/restart") or (record.node in replayed and not is_host_event):
            continue
        envelope = Envelope(
            record.node,
            record.boot,
            record.sequence,
            recording.tick_of(record) or 0,
            record.stamp_ns,
            record.publish_ns,
        )
        payload = record.payload
        if record.topic == JOURNAL_PREFIX + record.node:
            entry = decode_entry(payload)
            covered = messages_of(recording, record.node, record.boot, entry) or []
            payload = encode_entry(_chained(chains, writer, envelope, entry, covered))
        writer.message(record.topic, envelope, payload)
    for outcome in outcomes:
        for boot, sent, made in outcome.executed:
            for message in sent:
                writer.message(*message)
            envelope = Envelope(outcome.node, boot, made.step, made.tick, made.stamp_ns, 0)
            hosted = messages_of(recording, outcome.node, boot, replace(made, produced=())) or []
            messages = [*hosted, *((message.envelope.stamp_ns, message.payload) for message in sent)]
            writer.journal(envelope, encode_entry(_chained(chains, writer, envelope, made, messages)))


def _chained(
    chains: dict[str, bytes],
    writer: RecordingWriter,
    envelope: Envelope,
    entry: JournalEntry,
    messages: Iterable[tuple[int, bytes]],
) -> JournalEntry:
    """Return the entry with the next chain value of its node, if it is to have one; ``chains`` has the last ones."""
    node = envelope.node
    previous = chains.get(node) or genesis(node, writer.header.scenario)
    chain = chains[node] = chain_after(previous, envelope.boot, entry, messages)
    return replace(entry, chain=chain.hex() if entry.state else "")
