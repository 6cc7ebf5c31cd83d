"""Checks the journals of a recording: every step is there, the chain of digests holds, every message has its step."""

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, chain_after, decode_entry, genesis
from dynpf_protocol.topics import LOG_NODE

from dynpf_formats.recording.account import is_explained
from dynpf_formats.recording.findings import Finding, error, warning
from dynpf_formats.recording.reader import Recorded, Recording, Source

__all__ = ["check_journals", "messages_of", "unexplained"]


class _Reference(NamedTuple):
    how: str
    source: Source
    sequence: int


def check_journals(recording: Recording) -> Iterator[Finding]:
    """Yield what is wrong with the journals, and the messages that no step has produced."""
    named: Counter[Source] = Counter()
    ends: dict[str, JournalEntry] = {}
    for node in dict.fromkeys(node for node, _ in recording.journals()):
        yield from _Journal(recording, node, named, ends).check()
    if ends and not recording.header.writes:
        yield error("holds journals, but the metadata of the run name no node", "metadata run")
    if recording.end is not None and recording.end.complete:
        yield from _last_ticks(recording, ends)
    yield from unexplained(recording, named)


def unexplained(recording: Recording, named: Counter[Source]) -> Iterator[Finding]:
    """Yield the messages that no step has produced; ``named`` counts those that the journals name, by source.

    A run that broke off may hold messages of a step whose journal entry has not arrived any more.
    """
    if not recording.header.writes:
        return
    found = error if recording.end is not None and recording.end.complete else warning
    for source in recording.sources:
        if not is_explained(source.topic):
            continue
        extra = [record.sequence for record in recording.of(source)[-1:] if record.sequence >= named[source]]
        if extra:
            count = sum(1 for record in recording.of(source) if record.sequence >= named[source])
            what = f"{count} messages of {source.node}, boot {source.boot}, that no step of its journal produced"
            yield found(f"{what}, first sequence {named[source]}", source.topic)


def messages_of(recording: Recording, node: str, boot: str, entry: JournalEntry) -> list[tuple[int, bytes]] | None:
    """Return stamp and payload of the messages of a step, as its chain value covers them; None if one is missing."""
    found: list[tuple[int, bytes]] = []
    for made in entry.hosted:
        record = recording.find(made.node, boot, made.topic, made.sequence)
        if record is None:
            return None
        found.append((record.stamp_ns, record.payload))
    for own in entry.produced:
        record = recording.find(node, boot, own.topic, own.sequence)
        if record is None:
            return None
        found.append((record.stamp_ns, record.payload))
    return found


def _last_ticks(recording: Recording, ends: dict[str, JournalEntry]) -> Iterator[Finding]:
    """Yield the nodes that have not ended, and in lockstep those that have not ended at the same tick as the source."""
    nodes = recording.header.writes
    missing = [node for node in nodes if node not in ends]
    for node in missing:
        yield error("the journal is missing", JOURNAL_PREFIX + node)
    for node, entry in ends.items():
        if not entry.last:
            yield error(f"ends with tick {entry.tick}, which is not the node's last", JOURNAL_PREFIX + node)
    source = next(iter(nodes), None)
    if recording.header.clock == "lockstep" and source in ends:
        tick = ends[source].tick
        for node, entry in ends.items():
            if entry.tick != tick:
                yield error(f"ends with tick {entry.tick}; {source} ended with tick {tick}", JOURNAL_PREFIX + node)


class _Journal:
    """The check of one node's journal, from its first start to its last."""

    def __init__(self, recording: Recording, node: str, named: Counter[Source], ends: dict[str, JournalEntry]) -> None:
        self._recording = recording
        self._node = node
        self._where = JOURNAL_PREFIX + node
        self._named = named  # how many messages of each source the journals have named so far
        self._ends = ends
        self._chain = genesis(node, recording.header.scenario)
        self._since = 0  # the first step that the next written chain value covers
        self._whole = True  # whether all entries and messages since then are there
        self._tick = 0
        self._unresolved = 0
        self._first = ""

    def check(self) -> Iterator[Finding]:
        """Yield what is wrong."""
        for boot in [boot for node, boot in self._recording.journals() if node == self._node]:
            expected = 0
            for record in self._recording.of(Source(self._where, self._node, boot)):
                try:
                    entry = decode_entry(record.payload)
                except msgspec.DecodeError as bad:
                    yield error(f"entry {record.sequence} is unreadable: {bad}", self._where)
                    self._whole = False
                    continue
                yield from self._order(record, boot, entry, expected)
                messages = messages_of(self._recording, self._node, boot, entry)
                yield from self._references(boot, entry, found=messages is not None)
                yield from self._links(boot, entry, messages)
                expected = entry.step + 1
                self._ends[self._node] = entry
        if self._unresolved:
            yield error(f"{self._unresolved} references to messages that are not recorded{self._first}", self._where)

    def _order(self, record: Recorded, boot: str, entry: JournalEntry, expected: int) -> Iterator[Finding]:
        if entry.step != expected:
            missing = _range(expected, entry.step - 1) if entry.step > expected else f"{entry.step} again"
            yield error(f"missing: step {missing}, boot {boot}", self._where)
        if entry.step != record.sequence or entry.stamp_ns != record.stamp_ns:
            yield error(f"step {entry.step} is recorded under another number or time than its own", self._where)
        if entry.tick != self._tick and entry.step == expected:
            yield error(f"step {entry.step} is of tick {entry.tick}; expected {self._tick}", self._where)
        self._tick = entry.tick + 1
        before = self._ends.get(self._node)
        if before is not None and before.last:
            yield error(f"goes on after its last step, with step {entry.step}, boot {boot}", self._where)
        if (entry.last and not entry.state) or bool(entry.state) != bool(entry.chain):
            yield error(f"step {entry.step} lacks the digest of its state, or its chain value", self._where)

    def _references(self, boot: str, entry: JournalEntry, *, found: bool) -> Iterator[Finding]:
        """Yield the references that are not as they have to be; ``found`` says that all messages made are there."""
        made = [_Reference("produced", Source(made.topic, self._node, boot), made.sequence) for made in entry.produced]
        for hosted in entry.hosted:
            made.append(_Reference("published", Source(hosted.topic, hosted.node, boot), hosted.sequence))
            if hosted.node not in (self._node, LOG_NODE):
                yield error(f"step {entry.step} says to have published for {hosted.node!r}", self._where)
        for _, source, sequence in made:
            if sequence != self._named[source]:
                what = f"step {entry.step} names {source.topic} {sequence}; expected {self._named[source]}"
                yield error(what, self._where)
            self._named[source] = max(self._named[source], sequence + 1)
        for read in entry.consumed:
            self._resolve(entry, "consumed", Source(read.topic, read.node, read.boot), read.sequence)
        for reference in () if found else made:
            self._resolve(entry, *reference)

    def _resolve(self, entry: JournalEntry, how: str, source: Source, sequence: int) -> None:
        """Count a reference to a message that was not recorded, and tell of the first."""
        if self._recording.find(source.node, source.boot, source.topic, sequence) is None:
            self._unresolved += 1
            what = f"{source.topic} {sequence} of {source.node}, {how} in step {entry.step}"
            self._first = self._first or f", first {what}"

    def _links(self, boot: str, entry: JournalEntry, messages: list[tuple[int, bytes]] | None) -> Iterator[Finding]:
        """Yield where the chain of digests does not go on over the step, whose ``messages`` these are."""
        if messages is None:
            self._whole = False
        else:
            self._chain = chain_after(self._chain, boot, entry, messages)
        if not entry.chain:
            return
        if not self._whole or self._chain.hex() != entry.chain:
            steps = f"steps {self._since} to {entry.step}, boot {boot}"
            yield error(
                f"the chain of digests is broken in {steps}: an entry or a message was changed, removed or put in",
                self._where,
            )
        try:
            self._chain = bytes.fromhex(entry.chain)
        except ValueError:
            yield error(f"step {entry.step}: the chain value {entry.chain[:80]!r} is no digest", self._where)
        self._since, self._whole = entry.step + 1, True


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"
