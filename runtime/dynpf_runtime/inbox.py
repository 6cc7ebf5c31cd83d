"""Inboxes: decide when a node steps, and on which inputs in which order.

The lockstep inbox gives the same steps whatever the order of arrival. The realtime inbox takes messages as they arrive,
and the journal keeps what it took.
"""

import heapq
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import NamedTuple

from dynpf_protocol.control import TickDone
from dynpf_protocol.topics import LOG_NODE, Delivery, Topic

from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.graph import Graph
from dynpf_runtime.node import Received

__all__ = ["LockstepInbox", "Ready", "RealtimeInbox"]


class Ready(NamedTuple):
    """The inputs of a step, and its logical time."""

    tick: int
    stamp_ns: int
    inputs: list[Received]
    last: bool


class LockstepInbox:
    """Holds messages until every upstream node has ended the tick that the next step depends on."""

    def __init__(self, graph: Graph, node: str, link: FaultyLink) -> None:
        self._graph = graph
        self._lags = graph.lags[node]
        self._reads = graph.specs[node].reads
        self._link = link
        self._messages: defaultdict[tuple[str, int], list[Received]] = defaultdict(list)
        self._done: dict[tuple[str, int], TickDone] = {}
        self._refused: Counter[tuple[str, int]] = Counter()
        self._late: list[tuple[int, Received]] = []
        self.tick = 0

    def deliver(self, received: Received, tick: int, _now_ns: int = 0) -> None:
        """Add a message of a tick."""
        # The source publishes the records of a log.
        sender = self._graph.source if received.node == LOG_NODE else received.node
        self._messages[sender, tick].append(received)

    def deliver_refused(self, node: str, tick: int) -> None:
        """Count a message that arrived but was refused, so that the node does not wait for it."""
        self._refused[node, tick] += 1

    def done(self, done: TickDone) -> None:
        """Note that an upstream node has ended a tick."""
        if done.node in self._lags:
            self._done[done.node, done.tick] = done

    def take(self, stamp_ns: int = 0) -> Ready | None:
        """Return the next step's inputs and advance to the next tick, or None while a message is missing.

        The source of the run sets the time by ``stamp_ns``; other nodes get it from their upstream nodes.
        """
        needed = [(node, self.tick - lag) for node, lag in self._lags.items() if self.tick >= lag]
        if not all(self._complete(key) for key in needed):
            return None
        arrived: list[Received] = []
        last = False
        for key in needed:
            arrived += self._messages.pop(key, [])
            self._refused.pop(key, None)
            done = self._done.pop(key)
            if done.tick == self.tick:
                stamp_ns, last = done.stamp_ns, last or done.last
        ready = Ready(self.tick, stamp_ns, self._through_link(arrived, stamp_ns), last)
        self.tick += 1
        return ready

    def _complete(self, key: tuple[str, int]) -> bool:
        done = self._done.get(key)
        if done is None:
            return False
        expected = sum(count for topic, count in done.counts.items() if topic in self._reads)
        return len(self._messages.get(key, ())) + self._refused[key] >= expected

    def _through_link(self, arrived: list[Received], stamp_ns: int) -> list[Received]:
        on_time = self._delayed(arrived, stamp_ns) if self._link.faulty else arrived
        order = self._graph.input_order
        return sorted(on_time, key=lambda received: order(received.topic, received.node, received.sequence))

    def _delayed(self, arrived: list[Received], stamp_ns: int) -> list[Received]:
        """Return the messages that have come through the link by ``stamp_ns``."""
        for received in arrived:
            delay_ns = self._link.delay_ns(received.topic, received.sequence)
            if delay_ns is not None:
                self._late.append((received.stamp_ns + delay_ns if delay_ns else 0, received))
        on_time = [received for due_ns, received in self._late if due_ns <= stamp_ns]
        self._late = [(due_ns, received) for due_ns, received in self._late if due_ns > stamp_ns]
        return on_time


class RealtimeInbox:
    """Gives the node all messages that have arrived as soon as one of them triggers it, by the wall clock."""

    def __init__(self, graph: Graph, node: str, link: FaultyLink) -> None:
        self._topics = graph.topics
        self._running = {upstream for upstream, lag in graph.lags[node].items() if lag == 0}
        self._link = link
        self._arrived: list[Received] = []
        self._late: list[tuple[int, int, Received]] = []
        self._count = 0
        self._stamp_ns = 0
        self.tick = 0

    def deliver(self, received: Received, _tick: int, now_ns: int) -> None:
        """Add a message, unless the link loses it."""
        delay_ns = self._link.delay_ns(received.topic, received.sequence)
        if delay_ns is not None:
            self._count += 1
            heapq.heappush(self._late, (now_ns + delay_ns, self._count, received))

    def deliver_refused(self, node: str, tick: int) -> None:
        """Do nothing: in realtime no node waits for a message."""

    def done(self, done: TickDone) -> None:
        """Note that an upstream node has made its last step."""
        if done.last:
            self._running.discard(done.node)

    @property
    def upstream_ended(self) -> bool:
        """Whether every upstream node has made its last step."""
        return not self._running

    def due_ns(self) -> int | None:
        """Return when the next delayed message arrives, or None."""
        return self._late[0][0] if self._late else None

    def take(self, now_ns: int) -> Ready | None:
        """Return a step's inputs in order of arrival, or None while no message triggers the node."""
        self._arrive(now_ns)
        if any(self._topics[received.topic].wakes for received in self._arrived):
            return self._take(last=False)
        return None

    def take_all(self, now_ns: int) -> Ready:
        """Return all messages that have arrived, for a source at its tick and for the last step."""
        self._arrive(now_ns)
        return self._take(last=self.upstream_ended)

    def _arrive(self, now_ns: int) -> None:
        while self._late and self._late[0][0] <= now_ns:
            self._arrived.append(heapq.heappop(self._late)[2])

    def _take(self, *, last: bool) -> Ready:
        inputs, self._arrived = _fresh(self._arrived, self._topics), []
        self._stamp_ns = max([self._stamp_ns, *(received.stamp_ns for received in inputs)])
        self.tick += 1
        return Ready(self.tick - 1, self._stamp_ns, inputs, last)


def _fresh(arrived: list[Received], topics: Mapping[str, Topic]) -> list[Received]:
    """Return the messages, of FRESH topics only the newest."""
    newest: dict[str, int] = {}
    for index, received in enumerate(arrived):
        if received.topic not in newest or received.stamp_ns >= arrived[newest[received.topic]].stamp_ns:
            newest[received.topic] = index
    return [
        received
        for index, received in enumerate(arrived)
        if topics[received.topic].delivery is not Delivery.FRESH or newest[received.topic] == index
    ]
