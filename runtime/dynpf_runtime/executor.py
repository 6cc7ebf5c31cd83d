"""The executor: runs the steps of one node, numbers and encodes its messages, and makes the journal entries.

It is the same for the bus, inline and replay runners, and neither sends nor receives.
"""

import hashlib
import traceback
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import msgspec
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import StepError
from dynpf_protocol.journal import Consumed, Hosted, JournalEntry, Produced, chain_after
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import Topic

from dynpf_runtime.graph import NodeSpec
from dynpf_runtime.node import Node, Received, Result, Step, encode_state

__all__ = ["Executed", "Executor", "Sent", "Unsent"]

_REPORTS = frozenset({"notice", "diagnostics"})


class Sent(NamedTuple):
    """One encoded message."""

    topic: str
    envelope: Envelope
    payload: bytes

    def message(self, topics: Mapping[str, Topic]) -> Message:
        """Return the decoded payload; raises BadMessageError."""
        return decode(self.topic, self.payload, topics)


class Unsent(NamedTuple):
    """One message inside a process, never encoded."""

    topic: str
    envelope: Envelope
    content: Message

    def message(self, _topics: Mapping[str, Topic]) -> Message:
        """Return the message."""
        return self.content


class Executed(NamedTuple):
    """The result of one step: the messages, and whether the source declares it the last of the run."""

    sent: tuple[Sent, ...]
    finished: bool


class Executor:
    """Runs ``node``, which ``spec`` describes, under one boot.

    The journal has a state digest every ``digest_every`` steps and at the last, and the chain value with it; ``chain``
    is the value before the first step. The executor translates between the run's topics and the node's own names for
    them.
    """

    def __init__(
        self,
        node: Node,
        spec: NodeSpec,
        topics: Mapping[str, Topic],
        boot: str,
        digest_every: int,
        *,
        chain: bytes = b"",
    ) -> None:
        self.node = node
        self.spec = spec
        self.boot = boot
        self._topics = topics
        names = [*spec.reads.items(), *((row.name, own) for own, row in spec.writes.items())]
        self._renamed = any(topic != own for topic, own in names)
        self._digest_every = digest_every
        self.chain = chain
        self.frozen = b""  # the state after the last journalled step, if its entry has the digest
        self._sequences: defaultdict[str, int] = defaultdict(int)
        self.steps = 0

    def step(self, tick: int, stamp_ns: int, inputs: Sequence[Received], publish_ns: int) -> Executed:
        """Run the next step; call ``journal`` before the one after it.

        Raises StepError if the node raises, or returns messages that do not fit its topics.
        """
        try:
            result = self._result(tick, stamp_ns, inputs)
            sent = tuple([self.stamp(topic, message, tick, stamp_ns, publish_ns) for topic, message in result.outputs])
        except Exception as error:
            raise self._blame(tick, error) from error
        return Executed(sent, result.finished)

    def step_unsent(self, tick: int, stamp_ns: int, inputs: Sequence[Received]) -> tuple[tuple[Unsent, ...], bool]:
        """Run the next step without encoding messages and without a journal entry.

        Returns the messages, and whether the source declares it the last step. Raises StepError if the node raises or
        returns messages on topics that it does not declare.
        """
        try:
            result = self._result(tick, stamp_ns, inputs)
        except Exception as error:
            raise self._blame(tick, error) from error
        self.steps += 1
        return tuple(self.number(*output, tick, stamp_ns) for output in result.outputs), result.finished

    def journal(
        self,
        tick: int,
        stamp_ns: int,
        inputs: Sequence[Received],
        sent: Sequence[Sent],
        *,
        hosted: Sequence[Sent] = (),
        last: bool,
    ) -> JournalEntry:
        """Return the journal entry of the step just run, at intervals with the digest of the node's state.

        This is separate from ``step`` so that a host can first send the messages that others wait for. ``sent`` are the
        node's messages, ``hosted`` those that its host published in the step. ``last`` marks the node's last step.
        Raises StepError if the state cannot be encoded.
        """
        made = tuple([Hosted(one.envelope.node, one.topic, one.envelope.sequence) for one in hosted])
        entry = self.unchained(tick, stamp_ns, inputs, sent, hosted=made, last=last)
        messages = [(message.envelope.stamp_ns, message.payload) for message in (*hosted, *sent)]
        self.chain = chain_after(self.chain, self.boot, entry, messages)
        return msgspec.structs.replace(entry, chain=self.chain.hex()) if entry.state else entry

    def unchained(
        self,
        tick: int,
        stamp_ns: int,
        inputs: Sequence[Received],
        sent: Sequence[Sent],
        *,
        hosted: tuple[Hosted, ...] = (),
        last: bool,
    ) -> JournalEntry:
        """Return the journal entry of the step just run without a chain value, for a replay; see ``journal``."""
        self.frozen = self.freeze() if last or (self.steps + 1) % self._digest_every == 0 else b""
        entry = JournalEntry(
            step=self.steps,
            tick=tick,
            stamp_ns=stamp_ns,
            consumed=tuple([Consumed(item.node, item.boot, item.topic, item.sequence) for item in inputs]),
            produced=tuple([Produced(message.topic, message.envelope.sequence) for message in sent]),
            last=last,
            state=hashlib.sha256(self.frozen).hexdigest() if self.frozen else "",
            hosted=hosted,
        )
        self.steps += 1
        return entry

    def freeze(self) -> bytes:
        """Return the node's state, encoded; raises StepError if it cannot be."""
        try:
            return encode_state(self.node.freeze())
        except Exception as error:
            raise self._blame(self.steps, error) from error

    def sequences(self) -> dict[str, int]:
        """Return the next sequence number of each topic but the host's own reports, which come by the wall clock."""
        return {topic: count for topic, count in self._sequences.items() if topic not in _REPORTS}

    def thaw(self, steps: int, chain: bytes, sequences: Mapping[str, int]) -> None:
        """Go on after ``steps`` steps, with the journal's chain value and the next sequence numbers of that moment."""
        self.steps, self.chain = steps, chain
        self._sequences.update(sequences)

    def let_in(
        self, acts: Iterable[tuple[str, Message]], tick: int, stamp_ns: int, publish_ns: int
    ) -> tuple[tuple[Sent, ...], tuple[Received, ...]]:
        """Return what a person does in a tick as messages of the source, and those that its node reads."""
        found = [(self.stamp(topic, act, tick, stamp_ns, publish_ns), act) for topic, act in acts]
        read = [
            Received(one.topic, one.envelope.node, one.envelope.boot, one.envelope.sequence, stamp_ns, act)
            for one, act in found
            if one.topic in self.spec.reads
        ]
        return tuple(one for one, _ in found), tuple(read)

    def stamp(self, topic: str, message: Message, tick: int, stamp_ns: int, publish_ns: int) -> Sent:
        """Encode a message and give it the topic's next sequence number of this boot."""
        sequence = self._sequences[topic]
        payload = encode(topic, message, self._topics)
        self._sequences[topic] = sequence + 1
        envelope = Envelope(self.spec.name, self.boot, sequence, tick, stamp_ns, publish_ns)
        return Sent(topic, envelope, payload)

    def number(self, topic: str, message: Message, tick: int, stamp_ns: int) -> Unsent:
        """Give a message the topic's next sequence number of this boot, without encoding it."""
        sequence = self._sequences[topic]
        self._sequences[topic] = sequence + 1
        return Unsent(topic, Envelope(self.spec.name, self.boot, sequence, tick, stamp_ns, 0), message)

    def number_from(self, topic: str, sequence: int) -> None:
        """Give the topic's next message this sequence number, because those before have been sent."""
        self._sequences[topic] = max(sequence, self._sequences[topic])

    def _result(self, tick: int, stamp_ns: int, inputs: Sequence[Received]) -> Result:
        """Run the node's step, translating topics to its own names and back."""
        reads, writes = self.spec.reads, self.spec.writes
        if self._renamed:
            inputs = [received._replace(topic=reads[received.topic]) for received in inputs]
        result = self.node.step(Step(self.steps, tick, stamp_ns, tuple(inputs)))
        if undeclared := {output.topic for output in result.outputs if output.topic not in writes}:
            raise ValueError(f"returned messages for {', '.join(sorted(undeclared))}, which it does not declare")
        if not self._renamed:
            return result
        return result._replace(
            outputs=tuple(output._replace(topic=writes[output.topic].name) for output in result.outputs)
        )

    def _blame(self, tick: int, error: Exception) -> StepError:
        """Return an exception of a step as a StepError that names the node, the step and the line that raised it."""
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return StepError(
            f"{self.spec.name} failed in step {self.steps}, tick {tick}: {type(error).__name__}: {error} "
            f"({frame.filename}:{frame.lineno})"
        )
