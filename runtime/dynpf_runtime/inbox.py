"""Inboxes: decide when a node steps, and on which inputs in which order.

The lockstep inbox gives the same steps whatever order the network brought the messages in. The realtime inbox takes
messages as they come, and what it took is journalled.
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
    """Holds messages until every upstream node has ended the tick that the next step needs of it."""

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
        # Records of a log come from the source, which feeds them in.
        sender = self._graph.source if received.node == LOG_NODE else received.node
        self._messages[sender, tick].append(received)

    def deliver_refused(self, node: str, tick: int) -> None:
        """Count a message that came but cannot be given to the node, so that nobody waits for it."""
        self._refused[node, tick] += 1

    def done(self, done: TickDone) -> None:
        if done.node in self._lags:
            self._done[done.node, done.tick] = done

    def take(self, stamp_ns: int = 0) -> Ready | None:
        """Return the next step's inputs and go on to the next tick, or None while something is missing.

        The source of the run sets the time by ``stamp_ns``; the others have it from the nodes before them.
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
        return sorted(on_time, key=lambda one: self._graph.input_order(one.topic, one.node, one.sequence))

    def _delayed(self, arrived: list[Received], stamp_ns: int) -> list[Received]:
        """Return what has come through the link by now."""
        for one in arrived:
            delay_ns = self._link.delay_ns(one.topic, one.sequence)
            if delay_ns is not None:
                self._late.append((one.stamp_ns + delay_ns if delay_ns else 0, one))
        on_time = [one for due_ns, one in self._late if due_ns <= stamp_ns]
        self._late = [(due_ns, one) for due_ns, one in self._late if due_ns > stamp_ns]
        return on_time


class RealtimeInbox:
    """Gives the node whatever has arrived as soon as one of the messages triggers it; times are wall-clock."""

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
        delay_ns = self._link.delay_ns(received.topic, received.sequence)
        if delay_ns is not None:
            self._count += 1
            heapq.heappush(self._late, (now_ns + delay_ns, self._count, received))

    def deliver_refused(self, node: str, tick: int) -> None:
        """Nobody waits for a message here: what cannot be given to the node is simply missing."""

    def done(self, done: TickDone) -> None:
        if done.last:
            self._running.discard(done.node)

    @property
    def upstream_ended(self) -> bool:
        """Whether every node whose output this one needs has made its last step."""
        return not self._running

    def due_ns(self) -> int | None:
        """Return when the next delayed message arrives, or None."""
        return self._late[0][0] if self._late else None

    def take(self, now_ns: int) -> Ready | None:
        """Return a step's inputs in order of arrival, or None while nothing triggers the node."""
        self._arrive(now_ns)
        if any(self._topics[one.topic].wakes for one in self._arrived):
            return self._take(last=False)
        return None

    def take_all(self, now_ns: int) -> Ready:
        """Return whatever is there, for a source at its tick and for the last step."""
        self._arrive(now_ns)
        return self._take(last=self.upstream_ended)

    def _arrive(self, now_ns: int) -> None:
        while self._late and self._late[0][0] <= now_ns:
            self._arrived.append(heapq.heappop(self._late)[2])

    def _take(self, *, last: bool) -> Ready:
        inputs, self._arrived = _fresh(self._arrived, self._topics), []
        self._stamp_ns = max([self._stamp_ns, *(one.stamp_ns for one in inputs)])
        self.tick += 1
        return Ready(self.tick - 1, self._stamp_ns, inputs, last)


def _fresh(arrived: list[Received], topics: Mapping[str, Topic]) -> list[Received]:
    """Keep only the newest message of each topic of which only the newest matters."""
    newest: dict[str, int] = {}
    for place, one in enumerate(arrived):
        if one.topic not in newest or one.stamp_ns >= arrived[newest[one.topic]].stamp_ns:
            newest[one.topic] = place
    return [
        one
        for place, one in enumerate(arrived)
        if topics[one.topic].delivery is not Delivery.FRESH or newest[one.topic] == place
    ]
