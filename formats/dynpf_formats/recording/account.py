"""The account of a recording's messages: what is missing, repeated or unexplained, and digests of all the rest.

The writer keeps it while it records, and seals it in the end of the run. Who checks a recording keeps another one, of
what is in the file, and compares.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry
from dynpf_protocol.messages import Gap
from dynpf_protocol.topics import EVENT_PREFIX, is_compared

from dynpf_formats.recording.header import (
    Attachment,
    NodeEnd,
    RunEnd,
    RunHeader,
    SealedAttachment,
    SealedChannel,
    as_entries,
    seal_of,
)
from dynpf_formats.recording.stream import RecordedSchema, Source

__all__ = ["Account", "is_explained"]

_LISTED_GAPS = 1000
_MESSAGE = struct.Struct("<IQI")  # sequence, stamp, length of the payload that follows
_ARRIVAL = struct.Struct("<HQ")  # number of the channel, publish time


def is_explained(topic: str) -> bool:
    """Return whether the journal names the step of each message of a topic."""
    return not topic.startswith(JOURNAL_PREFIX) and (is_compared(topic) or topic.startswith(EVENT_PREFIX))


class _Track:
    """One source: its messages so far, the next sequence number, and the missing ranges."""

    __slots__ = ("count", "digest", "expected", "missing", "number")

    def __init__(self, number: int, source: Source, schema: RecordedSchema) -> None:
        self.number = number
        self.count = 0  # messages, with repetitions
        self.expected = 0
        self.missing: list[tuple[int, int]] = []
        described = [*source, schema.name, hashlib.sha256(schema.data).hexdigest()]
        self.digest = hashlib.sha256(msgspec.json.encode(described))

    def has(self, sequence: int) -> bool:
        """Return whether the message with this sequence number was recorded."""
        return sequence < self.expected and not any(first <= sequence <= last for first, last in self.missing)

    def fill(self, sequence: int) -> bool:
        """Remove ``sequence`` from the missing ranges; return False if it was not missing."""
        for index, (first, last) in enumerate(self.missing):
            if first <= sequence <= last:
                parts = ((first, sequence - 1), (sequence + 1, last))
                self.missing[index : index + 1] = [part for part in parts if part[0] <= part[1]]
                return True
        return False

    def distinct(self) -> int:
        """Return the number of messages without repetitions."""
        return self.expected - self.lost()

    def lost(self) -> int:
        """Return the number of missing messages."""
        return sum(last - first + 1 for first, last in self.missing)


class Account:
    """The account of one recording, whose messages are added in the order of the file."""

    def __init__(self, header: RunHeader, attachments: Sequence[Attachment]) -> None:
        self._header = header
        self._attachments = attachments
        self._tracks: dict[Source, _Track] = {}
        self._order = hashlib.sha256()
        self._unresolved: set[tuple[Source, int]] = set()
        self._named: Counter[Source] = Counter()
        self._nodes: dict[str, NodeEnd] = {}
        self._duplicates = 0
        self._late = 0

    @property
    def messages(self) -> int:
        """Messages so far, without the journal."""
        return sum(track.count for source, track in self._tracks.items() if not source.topic.startswith(JOURNAL_PREFIX))

    @property
    def missing(self) -> int:
        """Messages known to be missing so far."""
        return sum(track.lost() for track in self._tracks.values())

    def open(self, source: Source, schema: RecordedSchema) -> None:
        """Add a source, before its first message."""
        self._tracks[source] = _Track(len(self._tracks), source, schema)

    def gap(self, source: Source, sequence: int) -> Gap | None:
        """Return the gap that the message with this sequence number would leave before itself, if any."""
        track = self._tracks.get(source)
        expected = 0 if track is None else track.expected
        if sequence <= expected:
            return None
        return Gap(topic=source.topic, node=source.node, boot=source.boot, first=expected, last=sequence - 1)

    def add(
        self,
        source: Source,
        sequence: int,
        stamp_ns: int,
        publish_ns: int,
        payload: bytes,
        *,
        entry: JournalEntry | None,
    ) -> None:
        """Add the next message; ``entry`` is its content if it is a journal entry."""
        track = self._tracks[source]
        track.count += 1
        track.digest.update(_MESSAGE.pack(sequence, stamp_ns, len(payload)))
        track.digest.update(payload)
        self._order.update(_ARRIVAL.pack(track.number, publish_ns))
        if sequence == track.expected:
            track.expected += 1
        elif not self._irregular(track, sequence):
            return
        if entry is not None:
            self._refer(source.node, source.boot, entry)

    def settle(self) -> None:
        """Forget references to messages that have arrived by now."""
        self._unresolved = {reference for reference in self._unresolved if not self._resolves(*reference)}

    def end(self, complete: bool, reason: str, outcome: str) -> RunEnd:
        """Return the end of a recording with these messages; it is complete only if nothing is missing from the run."""
        self.settle()
        problem = next(self._problems(), "") if complete else ""
        whole = complete and not problem
        end = RunEnd(
            complete=whole,
            reason=problem or reason,
            outcome=outcome if whole else "",
            counts=self._counts(),
            gaps=self._gaps(),
            missing=self.missing,
            duplicates=self._duplicates,
            late=self._late,
            unresolved=len(self._unresolved),
            nodes=dict(sorted(self._nodes.items())),
            channels=tuple(SealedChannel(*source, track.digest.hexdigest()) for source, track in self._tracks.items()),
            order=self._order.hexdigest(),
            header=as_entries(self._header)["sha256"],
            attachments=tuple(
                SealedAttachment(item.name, item.media_type, hashlib.sha256(item.data).hexdigest())
                for item in self._attachments
            ),
        )
        return msgspec.structs.replace(end, seal=seal_of(end))

    def _irregular(self, track: _Track, sequence: int) -> bool:
        """Account for a message out of order; return whether it is no repetition."""
        if sequence > track.expected:
            track.missing.append((track.expected, sequence - 1))
            track.expected = sequence + 1
        elif track.fill(sequence):
            self._late += 1
        else:
            self._duplicates += 1
            return False
        return True

    def _refer(self, node: str, boot: str, entry: JournalEntry) -> None:
        """Note the messages that a step refers to, those that have not arrived yet, and how far the node has come."""
        made = [(Source(made.topic, node, boot), made.sequence) for made in entry.produced]
        made += [(Source(made.topic, made.node, boot), made.sequence) for made in entry.hosted]
        self._named.update(source for source, _ in made)
        read = [(Source(read.topic, read.node, read.boot), read.sequence) for read in entry.consumed]
        self._unresolved.update(reference for reference in (*made, *read) if not self._resolves(*reference))
        known = self._nodes.get(node)
        steps = 1 if known is None else known.steps + 1
        if known is not None and known.tick > entry.tick:
            self._nodes[node] = known._replace(steps=steps)
        else:
            self._nodes[node] = NodeEnd(steps, entry.tick, entry.last, entry.chain)

    def _resolves(self, source: Source, sequence: int) -> bool:
        track = self._tracks.get(source)
        return track is not None and track.has(sequence)

    def _problems(self) -> Iterator[str]:
        """Yield why this is not a complete run."""
        if self._unresolved:
            source, sequence = min(self._unresolved)
            yield (
                f"the journal refers to {len(self._unresolved)} messages that never arrived, first "
                f"{source.topic} {sequence} of {source.node}"
            )
        nodes = self._header.writes
        if not nodes:
            return  # an imported log: no node has made its messages
        for name in nodes:
            end = self._nodes.get(name)
            if end is None:
                yield f"the journal of {name} is missing"
            elif end.steps != end.tick + 1:
                yield f"the journal of {name} has {end.steps} steps up to tick {end.tick}; expected {end.tick + 1}"
            elif not end.last:
                yield f"the journal of {name} ends with tick {end.tick}, which is not its last"
        ticks = {name: end.tick for name, end in self._nodes.items()}
        if self._header.clock == "lockstep" and len(set(ticks.values())) > 1:
            yield f"the nodes ended at different ticks: {', '.join(f'{name} {tick}' for name, tick in ticks.items())}"
        for source, track in self._tracks.items():
            unexplained = track.distinct() - self._named[source] if is_explained(source.topic) else 0
            if unexplained > 0:
                yield f"no step of the journal produced {unexplained} messages on {source.topic} of {source.node}"

    def _counts(self) -> dict[str, int]:
        counts: dict[str, int] = {}
        for source, track in sorted(self._tracks.items()):
            counts[source.topic] = counts.get(source.topic, 0) + track.count
        return counts

    def _gaps(self) -> tuple[Gap, ...]:
        return tuple(
            Gap(topic=source.topic, node=source.node, boot=source.boot, first=first, last=last)
            for source, track in sorted(self._tracks.items())
            for first, last in track.missing
        )[:_LISTED_GAPS]
