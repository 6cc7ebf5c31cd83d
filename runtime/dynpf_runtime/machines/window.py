"""The recorder's window: what it has written, as a node's new start needs it to go on where the last one was."""

import hashlib
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from dynpf_protocol.control import TickDone, encode_control
from dynpf_protocol.envelope import Envelope, encode_envelope
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.keys import TICK, data_key
from dynpf_protocol.recall import Piece

from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.effects import Record

__all__ = ["Part", "Window", "end_of", "entry_digest"]

_PART_BYTES = 2**20
_PART_TICKS = 200
_MOST_BYTES = 2**27
"""What is kept at most; a node cannot come back into a run of which more has been written."""

_EACH = 400  # bytes that a message takes beside its payload


class _Step(NamedTuple):
    end: TickDone
    messages: list[Record]
    entry: bytes  # digest


class Part(NamedTuple):
    """What a node has read and done in the ticks before ``next_tick``, and whether there is more."""

    pieces: tuple[Piece, ...]
    entries: tuple[bytes, ...]
    next_tick: int
    more: bool


def entry_digest(payload: bytes) -> bytes:
    """Return a digest by which the same journal entry is known."""
    return hashlib.blake2b(payload, digest_size=16).digest()


def end_of(envelope: Envelope, entry: JournalEntry) -> TickDone:
    """Return a node's word that a step has ended, by its journal entry; only why the run's last one was is unknown."""
    counts = Counter(made.topic for made in entry.hosted) + Counter(made.topic for made in entry.produced)
    return TickDone(envelope.node, envelope.boot, entry.step, entry.tick, entry.stamp_ns, dict(counts), entry.last)


class Window:
    """The written steps of all nodes of a run with ``graph``."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._steps: dict[str, dict[int, _Step]] = {name: {} for name in graph.nodes}
        self._bytes = 0

    @property
    def whole(self) -> bool:
        """Whether everything is here; it is only kept while it is not too much."""
        return self._bytes <= _MOST_BYTES

    def wrote(self, end: TickDone | None, messages: Iterable[Record], entry: Record | None) -> None:
        """Add a step that has been written; nobody can do again what follows one of which a part is lost."""
        if entry is None or entry.entry is None:
            return
        if not self.whole:
            return
        end, messages = end or end_of(entry.envelope, entry.entry), list(messages)
        self._bytes += sum(_EACH + len(message.payload) for message in messages)
        if not self.whole:
            for steps in self._steps.values():
                steps.clear()
            return
        self._steps[end.node][end.tick] = _Step(end, messages, entry_digest(entry.payload))

    def found(self, record: Record, sender: str) -> None:
        """Add a message of a written step that has come late."""
        step = self._steps[sender].get(record.envelope.tick)
        if step is not None:
            step.messages.append(record)

    def part(self, name: str, tick: int) -> Part:
        """Return what a node has read and done from ``tick`` on, or as much of it as goes into one answer."""
        pieces: list[Piece] = []
        entries: list[bytes] = []
        size = 0
        lags, reads = self._graph.lags[name], self._graph.specs[name].reads
        until = 1 + max((max(self._steps[other], default=-1) for other in (*lags, name)), default=-1)
        first, own = tick, self._steps[name]
        while tick < until and tick < first + _PART_TICKS and size < _PART_BYTES:
            for other in lags:
                step = self._steps[other].get(tick)
                if step is not None:
                    read = [_piece(record) for record in step.messages if record.topic in reads]
                    pieces += [*read, Piece(TICK + other, encode_control(step.end), b"")]
                    size += sum(len(piece.payload) for piece in read)
            if tick in own:
                entries.append(own[tick].entry)
            tick += 1
        return Part(tuple(pieces), tuple(entries), tick, tick < until)


def _piece(record: Record) -> Piece:
    envelope = record.envelope
    return Piece(data_key(record.topic, envelope.node), record.payload, encode_envelope(envelope))
