"""Repeating: the steps that a node's new start does again in realtime, as the journal of the one before has them.

Which messages a step has read, and in which order, depended on when they arrived; only the journal tells. What has come
since the last of these steps was missed.
"""

from collections.abc import Mapping
from typing import NamedTuple

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import ProtocolError, RunError
from dynpf_protocol.journal import Consumed, JournalEntry, decode_entry
from dynpf_protocol.keys import JOURNAL, SHARED, TICK, topic_of
from dynpf_protocol.messages import HostEvent
from dynpf_protocol.recall import Piece
from dynpf_protocol.topics import EVENT_PREFIX, Topic

from dynpf_runtime.executor import Sent
from dynpf_runtime.gaps import GapWatch
from dynpf_runtime.inbox import Ready
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.machines.turns import Turn
from dynpf_runtime.node import Received
from dynpf_runtime.source import is_fed

__all__ = ["Again", "Repeating"]

_Place = tuple[str, str, int]
"""Node, topic and sequence of a message."""


class Again(NamedTuple):
    """A step to be done again: its turn, its journal entry, and the numbers of its first messages on topics on which
    the node's host speaks, too, at any time."""

    turn: Turn
    entry: bytes
    numbers: dict[str, int]


class Repeating:
    """The steps of the node ``name``, by what the recorder gives; ``topics`` are the run's."""

    def __init__(self, name: str, topics: Mapping[str, Topic]) -> None:
        self.held: dict[_Place, Received] = {}  # what an injected fault delayed at the last snapshot
        self._name, self._topics = name, topics
        self._here: dict[_Place, tuple[Envelope, bytes]] = {}
        self._ends: dict[str, Arrived] = {}

    def keep_end(self, arrived: Arrived) -> None:
        """Keep the word of another that it has ended a step, for it may be its last; what else comes is missed."""
        if arrived.key.startswith(TICK):
            self._ends[arrived.key] = arrived

    def ends(self) -> list[Arrived]:
        """Return what was kept."""
        return list(self._ends.values())

    def take(self, piece: Piece, gaps: GapWatch) -> Again | None:
        """Take a piece; return the step to be done again if it is a journal entry.

        ``gaps`` is what the node's host knows of gaps before the step. Raises RunError if something is not as the
        recorder has to give it.
        """
        try:
            if not piece.key.startswith(JOURNAL):
                envelope = decode_envelope(piece.attachment)
                place = envelope.node, topic_of(piece.key)[0], envelope.sequence
                self._here[place] = envelope, piece.payload
                return None
            entry = decode_entry(piece.payload)
            numbers = {made.topic: made.sequence for made in reversed(entry.produced) if made.topic in SHARED}
            return Again(self._turn(entry, gaps), piece.payload, numbers)
        except (ProtocolError, msgspec.DecodeError, KeyError) as error:
            raise RunError(f"{self._name} cannot come back: the recorder's answer is wrong: {error!r}") from error

    def _turn(self, entry: JournalEntry, gaps: GapWatch) -> Turn:
        own = EVENT_PREFIX + self._name
        inputs = [self._received(read) for read in entry.consumed if read.topic != own]
        fed, reports = [], []
        for made in entry.hosted:
            envelope, payload = self._here[made.node, made.topic, made.sequence]
            if is_fed(made):
                fed.append(Sent(made.topic, envelope, payload))
            else:
                reports.append(decode(made.topic, payload, self._topics))
        # Its host reports the gaps in what it reads again by itself; those of a live robot come after them.
        again = GapWatch()
        again.thaw(gaps.freeze())
        found = sum(again.see(one.topic, one.node, one.sequence) is not None for one in inputs)
        of_robot = tuple(report for report in reports[found:] if isinstance(report, HostEvent))
        self._here.clear()
        ready = Ready(entry.tick, entry.stamp_ns, inputs, entry.last)
        return Turn(ready, entry.stamp_ns, entry.last, tuple(fed), of_robot)

    def _received(self, read: Consumed) -> Received:
        place = read.node, read.topic, read.sequence
        if place not in self._here:
            return self.held[place]
        envelope, payload = self._here[place]
        message = decode(read.topic, payload, self._topics)
        return Received(read.topic, read.node, read.boot, read.sequence, envelope.stamp_ns, message)
