"""The recorder's window: what it has written, as a node's new start needs it to go on where the last one was.

A node goes on from its last snapshot, so only what has been said since then is kept: the memory does not grow with the
run.
"""

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.keys import TICK, data_key
from dynpf_protocol.recall import Piece

from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.effects import Record
from dynpf_runtime.machines.offers import Offers

__all__ = ["EACH", "MOST_BYTES", "PART_BYTES", "PART_TICKS", "Part", "Window", "end_of", "entry_digest", "piece_of"]

PART_BYTES = 2**20
PART_TICKS = 200
MOST_BYTES = 2**27
"""What is kept at most; a node cannot come back into a run of which more has been written since its last snapshot."""

EACH = 400
"""Bytes that a message takes beside its payload."""


class _Step(NamedTuple):
    end: TickDone
    messages: list[Record]
    entry: bytes  # digest
    size: int
    journal: JournalEntry | None  # if it has the digest of the state


class Part(NamedTuple):
    """What a node has read and done in the ticks before ``next_tick``, and whether there is more.

    ``snapshot`` is what it is to go on from first, if it has asked for what is no longer here, or need not be done
    again. ``whole`` says that nothing of this is lost.
    """

    pieces: tuple[Piece, ...]
    entries: tuple[bytes, ...]
    next_tick: int
    more: bool
    whole: bool = True
    snapshot: bytes = b""


def entry_digest(payload: bytes) -> bytes:
    """Return a digest by which the same journal entry is known."""
    return hashlib.blake2b(payload, digest_size=16).digest()


def end_of(envelope: Envelope, entry: JournalEntry) -> TickDone:
    """Return a node's word that a step has ended, by its journal entry; only why the run's last one was is unknown."""
    counts = Counter(made.topic for made in entry.hosted) + Counter(made.topic for made in entry.produced)
    return TickDone(envelope.node, envelope.boot, entry.step, entry.tick, entry.stamp_ns, dict(counts), entry.last)


class Window:
    """The written steps of all nodes of a run with ``graph``, since each node's last snapshot."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._steps: dict[str, dict[int, _Step]] = {name: {} for name in graph.nodes}
        self._begins = dict.fromkeys(graph.nodes, 0)  # the first tick from which on all steps of a node are here
        self._offers = Offers(graph.nodes)
        self._acts: dict[int, dict[tuple[str, int], Record]] = {}  # tick -> topic and sequence -> act
        self._bytes = 0

    @property
    def size(self) -> int:
        """How much is kept, bytes."""
        return self._bytes

    def wrote(self, end: TickDone | None, messages: Iterable[Record], entry: Record | None) -> None:
        """Add a step that has been written; nobody can do again what follows one of which a part is lost."""
        if entry is None or entry.entry is None:
            return
        end, messages = end or end_of(entry.envelope, entry.entry), list(messages)
        name, tick = end.node, end.tick
        size = sum(EACH + len(message.payload) for message in messages)
        if self._bytes + size > MOST_BYTES:
            self._clear()
        journal = entry.entry if entry.entry.state else None
        self._steps[name][tick] = _Step(end, messages, entry_digest(entry.payload), size, journal)
        self._bytes += size
        self._offers.wrote(name, tick, journal)

    def found(self, record: Record, sender: str) -> None:
        """Add a message of a written step that has come late."""
        step = self._steps[sender].get(record.envelope.tick)
        if step is not None:
            step.messages.append(record)

    def let_in(self, record: Record) -> None:
        """Add an act that the source has let in, before its step is written: others may have read of it."""
        place = record.topic, record.envelope.sequence
        self._acts.setdefault(record.envelope.tick, {})[place] = record

    def offer(self, name: str, payload: bytes) -> None:
        """Take a node's snapshot, before or after its step is written."""
        snapshot = self._offers.take(name, payload)
        if snapshot is not None and (step := self._steps[name].get(snapshot.tick)) is not None:
            self._offers.wrote(name, snapshot.tick, step.journal)

    def confirm(self, kept: Mapping[str, int]) -> None:
        """Let the snapshots count after whose steps nothing is lost: so many ticks of each node are in the file."""
        if self._offers.confirm(kept):
            self._forget()

    def part(self, name: str, tick: int) -> Part:
        """Return what a node has read and done from ``tick`` on, or as much of it as goes into one answer."""
        counting, lags, last = self._offers.counting.get(name), self._graph.lags[name], self._offers.last(name)
        if counting is not None and tick < last:
            whole = self._has(name, last)
            return Part((), (), last, True, whole, counting.payload if whole else b"")
        pieces: list[Piece] = []
        entries: list[bytes] = []
        size = 0
        reads = self._graph.specs[name].reads
        until = 1 + max((max(self._steps[other], default=-1) for other in (*lags, name)), default=-1)
        first, own = tick, self._steps[name]
        while tick < until and tick < first + PART_TICKS and size < PART_BYTES:
            for other in lags:
                step = self._steps[other].get(tick)
                if step is not None:
                    read = [piece_of(record) for record in step.messages if record.topic in reads]
                    pieces += [*read, Piece(TICK + other, encode_control(step.end), b"")]
                    size += sum(len(piece.payload) for piece in read)
            if tick in own:
                entries.append(own[tick].entry)
            tick += 1
        more = tick < until
        if name == self._graph.source:
            pieces[:0] = self._let_in(first, tick if more else None)
        return Part(tuple(pieces), tuple(entries), tick, more, self._has(name, first))

    def _let_in(self, first: int, end: int | None) -> list[Piece]:
        """Return the acts of ticks from ``first`` on, to the last known without an ``end``."""
        ticks = [tick for tick in sorted(self._acts) if tick >= first and (end is None or tick < end)]
        return [piece_of(record) for tick in ticks for record in self._acts[tick].values()]

    def _has(self, name: str, tick: int) -> bool:
        """Return whether all that a node needs is here from a tick on."""
        return all(self._begins[other] <= tick for other in (name, *self._graph.lags[name]))

    def _forget(self) -> None:
        """Forget what no node needs any more."""
        graph = self._graph
        needed = {name: max(0, self._offers.last(name)) for name in graph.nodes}
        for name, steps in self._steps.items():
            readers = [other for other in graph.nodes if other == name or name in graph.lags[other]]
            begin = min(needed[other] for other in readers)
            if begin > self._begins[name]:
                for tick in [tick for tick in steps if tick < begin]:
                    self._bytes -= steps.pop(tick).size
                self._begins[name] = begin
        self._acts = {tick: acts for tick, acts in self._acts.items() if tick >= needed[graph.source]}

    def _clear(self) -> None:
        """Forget everything: nobody can come back before its next snapshot."""
        for name, steps in self._steps.items():
            self._begins[name] = max(self._begins[name], 1 + max(steps, default=-1))
            steps.clear()
        self._bytes = 0


def piece_of(record: Record) -> Piece:
    """Return a message as it was published."""
    envelope = record.envelope
    return Piece(data_key(record.topic, envelope.node), record.payload, encode_envelope(envelope))
