"""The executor: runs the steps of one node, numbers and encodes what it returns, and journals what it consumed.

The same for the bus, inline and replay runners; it neither sends nor receives.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from protocol.codec import encode
from protocol.envelope import Envelope
from protocol.journal import Consumed, JournalEntry, Produced
from protocol.messages import Message
from services.node import Node, Received, Step, state_digest

__all__ = ["Executed", "Executor", "Sent"]


class Sent(NamedTuple):
    """One message as it travels."""

    topic: str
    envelope: Envelope
    payload: bytes


class Executed(NamedTuple):
    """What came of one step."""

    sent: tuple[Sent, ...]
    entry: JournalEntry
    finished: bool


class Executor:
    """Runs ``node`` under one boot. A state digest is taken every ``digest_every`` steps and at the last."""

    def __init__(self, node: Node, boot: str, digest_every: int) -> None:
        self.node = node
        self.boot = boot
        self._digest_every = digest_every
        self._sequences: defaultdict[str, int] = defaultdict(int)
        self.steps = 0

    def step(
        self, tick: int, stamp_ns: int, inputs: Sequence[Received], publish_ns: int, *, last: bool = False
    ) -> Executed:
        """Run the next step. ``last`` marks it as the node's last; the source's own word for that is ``finished``."""
        result = self.node.step(Step(self.steps, tick, stamp_ns, tuple(inputs)))
        sent = tuple(self.stamp(topic, message, tick, stamp_ns, publish_ns) for topic, message in result.outputs)
        last = last or result.finished
        digest = last or (self.steps + 1) % self._digest_every == 0
        entry = JournalEntry(
            step=self.steps,
            tick=tick,
            stamp_ns=stamp_ns,
            consumed=tuple(Consumed(one.node, one.boot, one.topic, one.sequence) for one in inputs),
            produced=tuple(Produced(one.topic, one.envelope.sequence) for one in sent),
            last=last,
            state=state_digest(self.node.freeze()) if digest else "",
        )
        self.steps += 1
        return Executed(sent, entry, result.finished)

    def stamp(self, topic: str, message: Message, tick: int, stamp_ns: int, publish_ns: int) -> Sent:
        """Give a message its place in this boot's sequence of its topic."""
        sequence = self._sequences[topic]
        payload = encode(topic, message)
        self._sequences[topic] = sequence + 1
        envelope = Envelope(self.node.name, self.boot, sequence, tick, stamp_ns, publish_ns)
        return Sent(topic, envelope, payload)
