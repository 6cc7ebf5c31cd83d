"""Intake: checks messages from the bus before a node gets them.

A bad message is refused and counted, and reported once per topic and reason; the process continues.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import NamedTuple

from dynpf_protocol.codec import decode
from dynpf_protocol.control import TickDone, decode_control
from dynpf_protocol.envelope import Envelope, decode_envelope
from dynpf_protocol.errors import ProtocolError
from dynpf_protocol.keys import TICK, data_key, topic_of
from dynpf_protocol.topics import LOG_NODE, topic

from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.node import Received

__all__ = ["Intake", "Refusal", "check_sender"]


class Refusal(NamedTuple):
    """Why a message was not accepted. ``envelope`` is set if the sender is known and genuine."""

    topic: str
    reason: str
    first_of_its_kind: bool
    envelope: Envelope | None = None


def check_sender(arrival: Arrived, boots: Mapping[str, str], graph: Graph) -> tuple[str, Envelope]:
    """Return topic and envelope of a message; raises ProtocolError if its sender is unknown.

    Records of an imported log carry the boot of the graph's source, which publishes them.
    """
    name, said_by = topic_of(arrival.key)
    row = topic(name, graph.topics)
    envelope = decode_envelope(arrival.attachment)
    sender = graph.source if envelope.node == LOG_NODE else envelope.node
    if envelope.node not in row.publishers:
        raise ProtocolError(f"unknown sender {envelope.node!r}; expected {' or '.join(row.publishers)}")
    if boots.get(sender) != envelope.boot:
        raise ProtocolError(
            f"unknown sender {envelope.node!r} with boot {envelope.boot!r}; this run's is {boots.get(sender)!r}"
        )
    if data_key(name, envelope.node) != arrival.key:
        raise ProtocolError(f"it comes in the name of {envelope.node!r}; its key is that of {said_by!r}")
    return name, envelope


class Intake:
    """Turns arrivals into a node's inputs, or refuses them. ``boots`` maps each peer to its boot in this run."""

    def __init__(self, boots: Mapping[str, str], graph: Graph) -> None:
        self._boots = boots
        self._graph = graph
        self._next: defaultdict[tuple[str, str], int] = defaultdict(int)
        self._reasons: set[tuple[str, str]] = set()
        self.refused: Counter[str] = Counter()

    def accept(self, arrival: Arrived) -> tuple[Received, Envelope] | Refusal:
        """Return a message as an input with its envelope, or refuse it."""
        name, _ = topic_of(arrival.key)
        envelope = None
        try:
            name, accepted = check_sender(arrival, self._boots, self._graph)
            key = (accepted.node, name)
            if accepted.sequence < self._next[key]:
                raise ProtocolError(f"sequence {accepted.sequence} again; expected {self._next[key]} or later")
            self._next[key] = accepted.sequence + 1
            envelope = accepted
            message = decode(name, arrival.payload, self._graph.topics)
        except ProtocolError as error:
            return self._refuse(name, str(error), envelope)
        return Received(name, accepted.node, accepted.boot, accepted.sequence, accepted.stamp_ns, message), accepted

    def accept_tick(self, arrival: Arrived) -> TickDone | Refusal:
        """Return a peer's notice that it has ended a tick, or refuse it."""
        node = arrival.key[len(TICK) :]
        try:
            done = decode_control(arrival.payload, TickDone)
            if done.node != node or self._boots.get(node) != done.boot:
                raise ProtocolError(f"unknown sender {done.node!r} with boot {done.boot!r}")
        except ProtocolError as error:
            return self._refuse(f"tick/{node}", str(error), None)
        return done

    def _refuse(self, name: str, reason: str, envelope: Envelope | None) -> Refusal:
        self.refused[name] += 1
        first = (name, reason) not in self._reasons and len(self._reasons) < 100
        if first:
            self._reasons.add((name, reason))
        return Refusal(name, reason, first, envelope)
