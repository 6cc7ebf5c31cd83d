"""Follows a run while it goes on: executes each node's steps again by the journal, and compares every byte.

A follower is given what is said on the bus: of each sender in its order, of several in any, and repetitions, too. A
node's twin begins with the run, or with a snapshot that agrees with the journal, and makes a step as soon as the
journal entry, all that it consumed and all that it produced are here. As twins get the inputs that the run's nodes had,
one that differs leads no other astray.
"""

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from functools import partial
from typing import NamedTuple

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import BadMessageError, ProtocolError, StepError, UnknownSenderError
from dynpf_protocol.journal import JournalEntry, decode_entry
from dynpf_protocol.keys import DATA, JOURNAL, topic_of
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.restoring import agreed, decode_snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import is_compared

from dynpf_runtime.executor import Executor
from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_runtime.replay import Mismatch, compare_step
from dynpf_runtime.snapshot import thaw_executor

__all__ = ["Divergence", "Follower", "Twin"]

MOST_BYTES = 256 * 2**20
"""How much is kept of what nodes read, bytes: a message that a fault delays may be consumed long after it was sent."""

MOST_ENTRIES = 4000
"""How many journal entries a twin keeps, while it waits for a message or a snapshot, which are at most 2000 steps
apart."""

_Source = tuple[str, str, str]  # node, boot, topic


class Divergence(NamedTuple):
    """The first difference between a node and its twin; ``offset`` counts the bytes of the payload before it.

    It is None where no payload differs, but what the journal says: a message that is absent, a state.
    """

    mismatch: Mismatch
    offset: int | None


class _Kept(NamedTuple):
    stamp_ns: int
    payload: bytes


class Twin:
    """One node that is executed again, and how far.

    ``begun`` has the steps from which on it was executed: 0, or those after the snapshots that it went on from.
    """

    def __init__(self, spec: NodeSpec) -> None:
        self.spec = spec
        self.steps = self.messages = 0
        self.begun: list[int] = []
        self.divergence: Divergence | None = None
        self.entries: dict[int, JournalEntry] = {}  # of steps to be executed
        self.boot = ""
        self.executor: Executor | None = None
        self.snapshot: Snapshot | None = None  # the newest one, while it does not know where to begin

    @property
    def pending(self) -> int:
        """How many steps the node has made since the twin began that were not executed again: something is lacking."""
        return len(self.entries) if self.begun else 0

    @property
    def next(self) -> JournalEntry | None:
        """The entry of the step to be executed next, if it is here."""
        return None if self.executor is None or self.divergence else self.entries.get(self.executor.steps)

    def is_beyond(self, tick: int) -> bool:
        """Return whether it has executed the step of a lockstep tick, or will not, as it has come too late."""
        return bool(self.boot) if self.executor is None else self.executor.steps > tick

    def take(self, boot: str, entry: JournalEntry) -> None:
        """Take a journal entry; raises UnknownSenderError for one of another boot."""
        if self.boot not in ("", boot):
            raise UnknownSenderError(f"journal of {self.spec.name}: boot {boot!r}; expected {self.boot!r}")
        self.boot = boot
        if self.divergence is None and (self.executor is None or entry.step >= self.executor.steps):
            self.entries.setdefault(entry.step, entry)
        if len(self.entries) > MOST_ENTRIES:
            self.executor = None  # what it waits for does not come any more
            del self.entries[min(self.entries)]


class Follower:
    """The twins of a run of ``plan``, and what they are still to read and to be compared with.

    Only ``by_snapshots`` they begin later than with the run.
    """

    def __init__(self, plan: Plan, *, by_snapshots: bool = True) -> None:
        self._plan, self._topics, self._by_snapshots = plan, plan.graph.topics, by_snapshots
        self.twins = {name: Twin(plan.graph.specs[name]) for name in plan.graph.nodes}
        self.refused = 0  # messages that cannot be read, or are not the run's
        self._read = {topic for spec in plan.graph.specs.values() for topic in spec.reads}
        self._kept: OrderedDict[tuple[_Source, int], _Kept] = OrderedDict()
        self._bytes = 0
        self._known: dict[_Source, int] = {}  # the first sequence that can still come, or is here

    @property
    def first(self) -> Divergence | None:
        """The divergence of the earliest tick; of one tick that of the first node in it."""
        found = [twin.divergence for twin in self.twins.values() if twin.divergence is not None]
        return min(found, key=lambda divergence: divergence.mismatch.tick, default=None)

    @property
    def settled(self) -> bool:
        """Whether no twin can diverge before the first divergence any more."""
        first = self.first
        if first is None:
            return False
        return self._plan.clock != "lockstep" or all(
            twin.divergence is not None or twin.is_beyond(first.mismatch.tick) for twin in self.twins.values()
        )

    def hear(self, arrived: Arrived) -> None:
        """Take what was said on the bus; what cannot be read or does not belong to the run is counted and left out."""
        try:
            if arrived.key.startswith(DATA):
                envelope = decode_envelope(arrived.attachment)
                topic, named = topic_of(arrived.key)
                if named not in ("", envelope.node):
                    raise UnknownSenderError(arrived.key)
                self.message(topic, envelope, arrived.payload)
            elif arrived.key.startswith(JOURNAL):
                envelope = decode_envelope(arrived.attachment)
                if envelope.node != arrived.key[len(JOURNAL) :]:
                    raise UnknownSenderError(arrived.key)
                self.entry(envelope.node, envelope.boot, decode_entry(arrived.payload))
        except (ProtocolError, msgspec.DecodeError):
            self.refused += 1

    def message(self, topic: str, envelope: Envelope, payload: bytes) -> None:
        """Take a message; raises BadMessageError for a snapshot that cannot be read."""
        if topic == SNAPSHOT_PREFIX + envelope.node:
            twin = self.twins.get(envelope.node)
            if self._by_snapshots and twin is not None and twin.executor is None:
                twin.snapshot = decode_snapshot(payload)
        elif topic in self._read or is_compared(topic):
            source, sequence = (envelope.node, envelope.boot, topic), envelope.sequence
            self._known[source] = min(self._known.get(source, sequence), sequence)
            if (source, sequence) not in self._kept:
                self._kept[source, sequence] = _Kept(envelope.stamp_ns, payload)
                self._bytes += len(payload)

    def entry(self, node: str, boot: str, entry: JournalEntry) -> None:
        """Take a journal entry; raises UnknownSenderError if it is none of the run's."""
        if node not in self.twins:
            raise UnknownSenderError(f"journal of {node!r}, which takes no part")
        self.twins[node].take(boot, entry)

    def advance(self) -> int:
        """Execute every step of which all is here, and return how many there were."""
        steps = 0
        for twin in self.twins.values():
            if twin.executor is None:
                self._begin(twin)
            while (entry := twin.next) is not None and self._execute(twin, entry):
                steps += 1
        while self._bytes > MOST_BYTES:
            (source, sequence), kept = self._kept.popitem(last=False)
            self._bytes -= len(kept.payload)
            self._known[source] = max(self._known[source], sequence + 1)
        return steps

    def _begin(self, twin: Twin) -> None:
        """Let a twin begin with the run, or with its newest snapshot if that agrees with the journal."""
        snapshot = None
        if 0 not in twin.entries:
            snapshot, twin.snapshot = twin.snapshot, None
            if snapshot is None or snapshot.step not in twin.entries:
                twin.snapshot = snapshot  # its entry may still come
                return
        executor = Executor(twin.spec.build(), twin.spec, self._topics, twin.boot, self._plan.state_digest_ticks)
        try:
            if snapshot is not None:
                agreed(snapshot, twin.entries[snapshot.step])
                thaw_executor(snapshot, executor)
        except BadMessageError:
            self.refused += 1
            return
        twin.executor = executor
        twin.begun.append(executor.steps)
        twin.entries = {step: entry for step, entry in twin.entries.items() if step >= executor.steps}

    def _execute(self, twin: Twin, entry: JournalEntry) -> bool:
        """Execute a step and compare it; return False if something of it is not here."""
        executor, name = twin.executor, twin.spec.name
        assert executor is not None
        needed = [((one.node, one.boot, one.topic), one.sequence) for one in entry.consumed]
        made = [((name, twin.boot, one.topic), one.sequence) for one in entry.produced if is_compared(one.topic)]
        for source, sequence in (*needed, *made):
            if (source, sequence) not in self._kept:
                if sequence < self._known.get(source, 0):  # said before anybody listened: it never comes
                    twin.executor = None
                    del twin.entries[entry.step]
                return False
        try:
            inputs = [self._received(*place) for place in needed]
            sent, finished = executor.step(entry.tick, entry.stamp_ns, inputs, 0)
            last = entry.last or finished
            again = executor.unchained(entry.tick, entry.stamp_ns, inputs, sent, hosted=entry.hosted, last=last)
            mismatch = compare_step(partial(self._find, name, twin.boot), name, (entry, again), sent)
        except (StepError, BadMessageError) as error:
            sent = ()
            mismatch = Mismatch(name, "", entry.tick, entry.step, "step", "made", str(error))
        if mismatch is not None:
            payloads = {(one.topic, one.envelope.sequence): one.payload for one in sent}
            twin.divergence = Divergence(mismatch, self._offset(twin, mismatch, payloads))
        else:
            twin.steps += 1
            twin.messages += len(sent)
        del twin.entries[entry.step]
        for place in made:
            if place[0][2] not in self._read:
                self._bytes -= len(self._kept.pop(place).payload)
        return mismatch is None

    def _received(self, source: _Source, sequence: int) -> Received:
        kept, (node, boot, topic) = self._kept[source, sequence], source
        return Received(topic, node, boot, sequence, kept.stamp_ns, decode(topic, kept.payload, self._topics))

    def _find(self, node: str, boot: str, topic: str, sequence: int) -> _Kept | None:
        return self._kept.get(((node, boot, topic), sequence))

    def _offset(self, twin: Twin, mismatch: Mismatch, payloads: Mapping[tuple[str, int], bytes]) -> int | None:
        """Return how many bytes of a payload are the same before the first that differs."""
        said = self._find(twin.spec.name, twin.boot, mismatch.topic, mismatch.sequence)
        again = payloads.get((mismatch.topic, mismatch.sequence))
        if said is None or again is None or said.payload == again:
            return None
        return next(_differing(said.payload, again), min(len(said.payload), len(again)))


def _differing(a: bytes, b: bytes) -> Iterator[int]:
    return (index for index, (left, right) in enumerate(zip(a, b, strict=False)) if left != right)
