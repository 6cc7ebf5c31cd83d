"""Branches of a recorded lockstep run: the run as it was up to a tick, and from there on with another plan.

The nodes are brought to that tick from their last snapshots before it, on the recorded messages, and have to do again
what they did. Then the run goes on in this process as the inline runner goes on.
"""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from dynpf_formats.recording.journals import messages_of
from dynpf_formats.recording.reader import Recorded, Recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.codec import decode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError, RunError, UsageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, chain_after, decode_entry, encode_entry, genesis
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.restoring import agreed, decode_snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, pack, unpack
from dynpf_protocol.topics import is_act
from msgspec.structs import replace

from dynpf_runtime.executor import Sent
from dynpf_runtime.inline import Begun, Ran, run_inline
from dynpf_runtime.node import Received, Takeover
from dynpf_runtime.plan import Plan
from dynpf_runtime.seat import Made, Seat
from dynpf_runtime.source import LogRecord, is_fed

__all__ = ["Branch", "Past", "branch", "brought"]


class Branch(NamedTuple):
    """A branched run: how it ended, and the changed nodes that began there in their first state."""

    ran: Ran
    fresh: tuple[str, ...]


def branch(
    recording: Recording,
    plan: Plan,
    changed: tuple[Plan, Container[str]],
    at: int,
    *,
    log: Iterable[LogRecord],
    acts: Mapping[int, Sequence[LogRecord]],
    writer: RecordingWriter,
) -> Branch:
    """Write the run of ``plan`` up to the tick ``at``, which is the first of another plan, and run that to its end.

    ``changed`` has the other plan and the names of the nodes that are others in it. Such a node keeps the state of the
    one before it if it can, else it begins in its first state. ``acts`` are what a person did, by tick.

    Raises UsageError if there is no such tick, RunError if the nodes do not do again what they did.
    """
    past = Past(recording, plan, at)
    chains = past.copy(writer, changed[0])
    snapshots = {
        name: replace(_first_of_its_kind(name, past.freeze(name)), chain=chains[name].hex())
        for name in plan.graph.nodes
    }
    seats, fresh = past.seats(snapshots, *changed)
    ran = run_inline(changed[0], log, writer, begun=Begun(at, seats), acts=acts)
    return Branch(ran, fresh)


def brought(recording: Recording, plan: Plan, at: int) -> Begun:
    """Return the nodes of a recorded run of ``plan`` as they were before its tick ``at``.

    Raises UsageError if there is no step of each before, and after, that moment; RunError if the nodes do not do again
    what they did.
    """
    past = Past(recording, plan, at)
    seats = {name: past.bring(name).seat for name in plan.graph.nodes}
    for seat in seats.values():
        past.expect(seat, plan)
    return Begun(at, seats)


def _seat(plan: Plan, name: str, boot: str) -> Seat:
    return Seat(plan.graph.specs[name], plan, boot)


class _Brought(NamedTuple):
    """A node after some ticks, its last step, if it had to make any, and the snapshot that it began from, if any."""

    seat: Seat
    made: Made | None
    begun: Snapshot | None


class Past:
    """The ticks of a recorded run before the tick ``at``.

    Raises UsageError if the run has no steps of every node before and after it.
    """

    def __init__(self, recording: Recording, plan: Plan, at: int) -> None:
        self._recording, self._plan, self._at = recording, plan, at
        self._topics = plan.graph.topics
        self.boots: dict[str, str] = {}
        self._entries: dict[str, list[JournalEntry]] = {}
        for name in plan.graph.nodes:
            boots = [boot for node, boot in recording.journals() if node == name]
            if len(boots) != 1:
                raise UsageError(f"{recording.path}: {name} has {len(boots)} journals; a branch needs one of each node")
            self.boots[name] = boots[0]
            entries = self._entries[name] = [*recording.journal(name, boots[0])][:at]
            if not 0 < at <= len(entries) or entries[-1].last or entries[-1].tick != at - 1:
                raise UsageError(f"{recording.path}: {name} has no step before and after tick {at}: nothing to branch")

    def copy(self, writer: RecordingWriter, plan: Plan) -> dict[str, bytes]:
        """Write all that belongs to these ticks, the journals chained for another plan; return the chain values."""
        chains = {name: genesis(name, plan.text) for name in self.boots}
        written = {
            (made.node, made.topic, made.sequence)
            for name, entries in self._entries.items()
            for entry in entries
            for made in _messages(name, entry)
        }
        for record in self._recording.records:
            envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
            if record.topic == JOURNAL_PREFIX + record.node:
                if record.sequence >= self._at:
                    continue
                entry = decode_entry(record.payload)
                messages = messages_of(self._recording, record.node, record.boot, entry) or []
                chain = chains[record.node] = chain_after(chains[record.node], record.boot, entry, messages)
                entry = replace(entry, chain=chain.hex() if entry.state else "")
                writer.journal(envelope, encode_entry(entry))
            elif (record.node, record.topic, record.sequence) in written:
                writer.message(record.topic, envelope, record.payload)
        return chains

    def freeze(self, name: str, known: Snapshot | None = None) -> Snapshot:
        """Return a snapshot of a node after the last of these ticks; see ``bring``."""
        seat, made, begun = self.bring(name, known)
        if made is None:
            assert begun is not None
            return begun
        snapshot = seat.freeze(made.entry)
        if snapshot is None:
            raise UsageError(f"the state of {name} is too large for a snapshot: its run cannot be branched")
        return snapshot

    def bring(self, name: str, known: Snapshot | None = None) -> _Brought:
        """Return a node after the last of these ticks; raises RunError if it does something else than it did.

        ``known`` is a snapshot that was made for an earlier tick.
        """
        seat = _seat(self._plan, name, self.boots[name])
        begun = max(filter(None, (known, self._last_snapshot(name))), key=lambda one: one.step, default=None)
        step = -1
        if begun is not None:
            try:
                seat.thaw(begun)
                step = begun.step
            except BadMessageError:
                seat = _seat(self._plan, name, self.boots[name])
        made: Made | None = None
        for tick in range(step + 1, self._at):
            made = self._step(seat, tick)
        return _Brought(seat, made, begun)

    def seats(
        self, snapshots: Mapping[str, Snapshot], plan: Plan, others: Container[str]
    ) -> tuple[dict[str, Seat], tuple[str, ...]]:
        """Return the seats of a run of another plan that goes on after these ticks, and the nodes that begin anew.

        ``snapshots`` are those of all nodes after these ticks. ``others`` are the nodes that are others in that plan.
        """
        seats, fresh = {}, []
        for name in plan.graph.nodes:
            seat = _seat(plan, name, self.boots[name])
            try:
                seat.thaw(snapshots[name], Takeover.OTHER if name in others else Takeover.ITSELF)
            except BadMessageError:
                if name not in others:
                    raise
                fresh.append(name)
                seat = _seat(plan, name, self.boots[name])
                seat.thaw(snapshots[name], Takeover.FRESH)
            self.expect(seat, plan)
            seats[name] = seat
        return seats, tuple(fresh)

    def expect(self, seat: Seat, plan: Plan) -> None:
        """Give a seat what was sent to it and is not consumed, and the numbers of topics that it has not read before.

        ``plan`` is that of the seat.
        """
        lags = plan.graph.lags[seat.name]
        frozen = seat.inbox.freeze()
        following = dict(frozen.next)
        for other, lag in lags.items():
            sent = Counter(made.topic for entry in self._entries[other][: self._at - lag] for made in entry.produced)
            following = {**{topic: count for topic, count in sent.items() if topic in seat.reads}, **following}
        seat.inbox.thaw(replace(frozen, next=following))
        for other, lag in lags.items():
            if lag:
                self._hear(seat, other, self._at - lag)

    def _last_snapshot(self, name: str) -> Snapshot | None:
        """Return the last snapshot that agrees with the journal, or None."""
        records = [*self._recording.messages(SNAPSHOT_PREFIX + name, name)]
        for record in reversed(records):
            try:
                snapshot = decode_snapshot(record.payload)
                if snapshot.step < self._at:
                    agreed(snapshot, self._entries[name][snapshot.step])
                    return snapshot
            except BadMessageError:
                continue
        return None

    def _step(self, seat: Seat, tick: int) -> Made:
        name, entry = seat.name, self._entries[seat.name][tick]
        for other, lag in self._plan.graph.lags[name].items():
            if tick >= lag:
                self._hear(seat, other, tick - lag)
        hosted = [self._find(name, made.node, made.topic, made.sequence) for made in entry.hosted]
        records = [record for record in hosted if is_fed(record)]
        acts = [LogRecord(record.topic, record.stamp_ns, record.payload) for record in records if is_act(record.topic)]
        let_in, read = seat.let_in(acts, tick, entry.stamp_ns)
        records = [record for record in records if not is_act(record.topic)]
        fed = (*let_in, *(_sent(record, tick) for record in records))
        inputs = [*read, *(self._received(record) for record in records if record.topic in seat.reads)]
        ready = seat.take(entry.stamp_ns)
        made = seat.step(ready._replace(inputs=[*inputs, *ready.inputs]), entry.stamp_ns, fed, last=False)
        found = [self._find(name, *place) for place in _messages(name, entry)]
        if made.entry != entry or [one.payload for one in made.sent] != [record.payload for record in found]:
            raise RunError(
                f"{self._recording.path}: {name} does in step {entry.step} something else than in the recording, which "
                "cannot be branched then; dynpf replay tells what differs"
            )
        return made

    def _hear(self, seat: Seat, other: str, tick: int) -> None:
        """Give a seat what a node has sent in a tick."""
        entry = self._entries[other][tick]
        found = [self._find(other, *place) for place in _messages(other, entry)]
        for record in found:
            if record.topic in seat.reads:
                seat.inbox.deliver(self._received(record), tick)
        counts = dict(Counter(record.topic for record in found))
        seat.inbox.done(TickDone(other, self.boots[other], entry.step, tick, entry.stamp_ns, counts, entry.last))

    def _find(self, node: str, sender: str, topic: str, sequence: int) -> Recorded:
        record = self._recording.find(sender, self.boots[node], topic, sequence)
        if record is None:
            raise UsageError(f"{self._recording.path}: lacks {topic} {sequence} of {sender}; dynpf doctor tells more")
        return record

    def _received(self, record: Recorded) -> Received:
        message = decode(record.topic, record.payload, self._topics)
        return Received(record.topic, record.node, record.boot, record.sequence, record.stamp_ns, message)


def _first_of_its_kind(name: str, snapshot: Snapshot) -> Snapshot:
    """Return a snapshot before which there are no others: those of the recording are of its own scenario."""
    frozen = unpack(snapshot.state)
    sequences = {topic: count for topic, count in frozen.sequences.items() if topic != SNAPSHOT_PREFIX + name}
    packed = pack(replace(frozen, sequences=sequences))
    assert packed is not None, "it has become smaller"
    return replace(snapshot, state=packed)


class _Place(NamedTuple):
    node: str
    topic: str
    sequence: int


def _messages(name: str, entry: JournalEntry) -> Iterator[_Place]:
    """Yield the messages of a step, in the order in which they were sent."""
    yield from (_Place(made.node, made.topic, made.sequence) for made in entry.hosted)
    yield from (_Place(name, made.topic, made.sequence) for made in entry.produced)


def _sent(record: Recorded, tick: int) -> Sent:
    envelope = Envelope(record.node, record.boot, record.sequence, tick, record.stamp_ns, 0)
    return Sent(record.topic, envelope, record.payload)
