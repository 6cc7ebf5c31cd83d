"""The executor: runs the steps of one node, numbers and encodes what it returns, and journals what it consumed.

The same for the bus, inline and replay runners; it neither sends nor receives.
"""

import traceback
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import StepError
from dynpf_protocol.journal import Consumed, JournalEntry, Produced
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import Topic

from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.node import Node, Received, Result, Step, state_digest

__all__ = ["Executed", "Executor", "Sent", "Unsent"]


class Sent(NamedTuple):
    """One message as it travels."""

    topic: str
    envelope: Envelope
    payload: bytes

    def message(self, topics: Mapping[str, Topic]) -> Message:
        """Decode the payload."""
        return decode(self.topic, self.payload, topics)


class Unsent(NamedTuple):
    """One message that stays in its process and is never encoded."""

    topic: str
    envelope: Envelope
    content: Message

    def message(self, _topics: Mapping[str, Topic]) -> Message:
        return self.content


class Executed(NamedTuple):
    """What came of one step: the messages, and whether the source says that it was the last."""

    sent: tuple[Sent, ...]
    finished: bool


class Executor:
    """Runs ``node``, which ``spec`` describes, under one boot.

    A state digest is taken every ``digest_every`` steps and at the last. The node is given and gives its topics by its
    own names for them.
    """

    def __init__(self, node: Node, spec: NodeSpec, topics: Mapping[str, Topic], boot: str, digest_every: int) -> None:
        self.node = node
        self.spec = spec
        self.boot = boot
        self._topics = topics
        names = [*spec.reads.items(), *((row.name, own) for own, row in spec.writes.items())]
        self._renamed = any(topic != own for topic, own in names)
        self._digest_every = digest_every
        self._sequences: defaultdict[str, int] = defaultdict(int)
        self.steps = 0

    def step(self, tick: int, stamp_ns: int, inputs: Sequence[Received], publish_ns: int) -> Executed:
        """Run the next step; ``journal`` has to follow before the one after it.

        Raises StepError where the node raises, or returns what its topics do not promise.
        """
        with self._blamed(tick):
            result = self._result(tick, stamp_ns, inputs)
            sent = tuple(self.stamp(topic, message, tick, stamp_ns, publish_ns) for topic, message in result.outputs)
        return Executed(sent, result.finished)

    def step_unsent(self, tick: int, stamp_ns: int, inputs: Sequence[Received]) -> tuple[tuple[Unsent, ...], bool]:
        """Run the next step for this process alone: nothing is encoded, and no entry of a journal follows.

        Returns the messages, and whether the source says that it was the last step. Raises StepError where the node
        raises or returns messages that it does not declare.
        """
        with self._blamed(tick):
            result = self._result(tick, stamp_ns, inputs)
        self.steps += 1
        return tuple(self.number(*output, tick, stamp_ns) for output in result.outputs), result.finished

    def journal(
        self, tick: int, stamp_ns: int, inputs: Sequence[Received], sent: Sequence[Sent], *, last: bool
    ) -> JournalEntry:
        """Account for the step just run: what it consumed and produced, and at intervals the digest of the state.

        Apart from ``step`` so that a host can send what others wait for first. ``last`` marks the node's last step.
        """
        state = ""
        if last or (self.steps + 1) % self._digest_every == 0:
            with self._blamed(tick):
                state = state_digest(self.node.freeze())
        entry = JournalEntry(
            step=self.steps,
            tick=tick,
            stamp_ns=stamp_ns,
            consumed=tuple(Consumed(one.node, one.boot, one.topic, one.sequence) for one in inputs),
            produced=tuple(Produced(one.topic, one.envelope.sequence) for one in sent),
            last=last,
            state=state,
        )
        self.steps += 1
        return entry

    def stamp(self, topic: str, message: Message, tick: int, stamp_ns: int, publish_ns: int) -> Sent:
        """Give a message its place in this boot's sequence of its topic."""
        sequence = self._sequences[topic]
        payload = encode(topic, message, self._topics)
        self._sequences[topic] = sequence + 1
        envelope = Envelope(self.spec.name, self.boot, sequence, tick, stamp_ns, publish_ns)
        return Sent(topic, envelope, payload)

    def number(self, topic: str, message: Message, tick: int, stamp_ns: int) -> Unsent:
        """Give a message its place in this boot's sequence of its topic, without encoding it."""
        sequence = self._sequences[topic]
        self._sequences[topic] = sequence + 1
        return Unsent(topic, Envelope(self.spec.name, self.boot, sequence, tick, stamp_ns, 0), message)

    def _result(self, tick: int, stamp_ns: int, inputs: Sequence[Received]) -> Result:
        """Let the node take its step, in which the topics go by its own names for them."""
        reads, writes = self.spec.reads, self.spec.writes
        if self._renamed:
            inputs = [received._replace(topic=reads[received.topic]) for received in inputs]
        result = self.node.step(Step(self.steps, tick, stamp_ns, tuple(inputs)))
        if undeclared := {output.topic for output in result.outputs} - writes.keys():
            raise ValueError(f"returned messages for {', '.join(sorted(undeclared))}, which it does not declare")
        if not self._renamed:
            return result
        return result._replace(
            outputs=tuple(output._replace(topic=writes[output.topic].name) for output in result.outputs)
        )

    @contextmanager
    def _blamed(self, tick: int) -> Iterator[None]:
        """Say of an exception which node raised it, in which step, and where."""
        try:
            yield
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            raise StepError(
                f"{self.spec.name} failed in step {self.steps}, tick {tick}: {type(error).__name__}: {error} "
                f"({place.filename}:{place.lineno})"
            ) from error
