"""Gaps: messages that never reached a node, found by jumps in the sequence numbers of those that it consumes."""

from collections.abc import Iterable

from dynpf_protocol.messages import HostEvent
from dynpf_protocol.snapshots import Expected
from dynpf_protocol.topics import EVENT_PREFIX

from dynpf_runtime.executor import Executor, Sent
from dynpf_runtime.inbox import Ready
from dynpf_runtime.node import Received

__all__ = ["GapWatch", "notice_gaps"]


class GapWatch:
    """Tracks the next expected sequence number of each sender and topic. Late messages do not close reported gaps."""

    def __init__(self) -> None:
        self._next: dict[tuple[str, str], int] = {}

    def see(self, topic: str, node: str, sequence: int) -> HostEvent | None:
        """Return the gap before this message, if any."""
        expected = self._next.get((topic, node), 0)
        self._next[topic, node] = max(expected, sequence + 1)
        if sequence <= expected:
            return None
        return HostEvent(kind="gap", topic=topic, node=node, first=expected, last=sequence - 1)

    def freeze(self) -> tuple[Expected, ...]:
        """Return the whole state."""
        return tuple(Expected(*source, sequence) for source, sequence in sorted(self._next.items()))

    def thaw(self, expected: Iterable[Expected]) -> None:
        """Restore what ``freeze`` returned."""
        self._next = {(one.topic, one.node): one.sequence for one in expected}


def notice_gaps(executor: Executor, watch: GapWatch, ready: Ready, stamp_ns: int, publish_ns: int) -> list[Sent]:
    """Return an event for each gap in the inputs, and add it to the inputs if the node reads such events."""
    topic = EVENT_PREFIX + executor.spec.name
    sent = []
    for received in list(ready.inputs):
        event = watch.see(received.topic, received.node, received.sequence)
        if event is None:
            continue
        sent_event = executor.stamp(topic, event, ready.tick, stamp_ns, publish_ns)
        sent.append(sent_event)
        if topic in executor.spec.reads:
            envelope = sent_event.envelope
            ready.inputs.append(Received(topic, envelope.node, envelope.boot, envelope.sequence, stamp_ns, event))
    return sent
