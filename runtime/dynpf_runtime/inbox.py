"""Inboxes: decide when a node steps, and on which inputs in which order.

The lockstep inbox gives the same steps whatever the order of arrival. The realtime inbox takes messages as they arrive,
and the journal keeps what it took.
"""

import heapq
from collections import defaultdict, deque
from collections.abc import Container, Mapping
from typing import NamedTuple

from dynpf_protocol.codec import decode, encode
from dynpf_protocol.control import TickDone
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import OrderError, RepeatError
from dynpf_protocol.snapshots import FrozenInbox, Held, Seen
from dynpf_protocol.topics import LOG_NODE, Delivery, Topic

from dynpf_runtime.faults import FaultyLink
from dynpf_runtime.graph import Graph
from dynpf_runtime.node import Received
from dynpf_runtime.sequence_numbers import SeenNumbers

__all__ = ["LockstepInbox", "Ready", "RealtimeInbox"]


_Place = tuple[str, int]
"""Topic and sequence of a message."""

_ENDS = 64
"""How many different ends of one tick are kept at most."""

_AHEAD = 2**17
"""How far a sequence may be ahead of the tick that is to be taken: two ticks of as many messages as are allowed."""


class Ready(NamedTuple):
    """The inputs of a step, and its logical time."""

    tick: int
    stamp_ns: int
    inputs: list[Received]
    last: bool


class LockstepInbox:
    """Holds messages until every upstream node has ended the tick that the next step depends on.

    The end of a tick says how many messages its node has sent on each topic; as they are numbered without gaps, it says
    which ones belong to the tick. A tick is complete when these are here, and what else has come for it is dropped.
    """

    def __init__(self, graph: Graph, node: str, link: FaultyLink) -> None:
        self._graph = graph
        self._lags = graph.lags[node]
        self._reads = graph.specs[node].reads
        self._link = link
        self._messages: defaultdict[tuple[str, int], dict[_Place, Received | None]] = defaultdict(dict)
        self._ends: dict[tuple[str, int], deque[TickDone]] = {}
        self._next: defaultdict[str, int] = defaultdict(int)  # topic -> the first sequence of the tick not yet taken
        self._late: list[tuple[int, Received]] = []
        self.tick = 0

    def admit(self, name: str, sender: str, envelope: Envelope) -> None:
        """Raise OrderError for a message that ``sender`` does not send now: of another tick, ahead, or again."""
        _check_read(name, self._reads)
        tick = envelope.tick
        self._admit(sender, tick)
        ahead = envelope.sequence - self._next[name]
        if not 0 <= ahead < _AHEAD:
            raise _order(ahead)(f"sequence {envelope.sequence} in tick {tick}; expected {self._next[name]} or the next")
        here = self._messages.get((sender, tick))
        if here is not None and here.get((name, envelope.sequence)) is not None:
            raise RepeatError(f"sequence {envelope.sequence} again in tick {tick}")

    def admit_end(self, done: TickDone) -> None:
        """Raise OrderError for the end of a tick that its node does not end now."""
        self._admit(done.node, done.tick)
        if done in self._ends.get((done.node, done.tick), ()):
            raise RepeatError(f"the end of tick {done.tick} again")

    def _admit(self, sender: str, tick: int) -> None:
        """Raise OrderError for a tick that is over, or that ``sender`` cannot be in before this node has made its step.

        Tick k + 1 begins only after every node has ended tick k.
        """
        lag = self._lags.get(sender)
        if lag is None:
            raise OrderError(f"no step waits for {sender}")
        if not max(0, self.tick - lag) <= tick <= self.tick:
            error = _order(tick - max(0, self.tick - lag))
            raise error(f"tick {tick}; expected {max(0, self.tick - lag)}, which {sender} is in")

    def deliver(self, received: Received, tick: int, _now_ns: int = 0) -> None:
        """Add a message of a tick."""
        # The source publishes the records of a log.
        sender = self._graph.source if received.node == LOG_NODE else received.node
        self._messages[sender, tick][received.topic, received.sequence] = received

    def deliver_refused(self, name: str, sender: str, envelope: Envelope) -> None:
        """Note a message whose content was refused, so that the node does not wait for it; another may replace it."""
        self._messages[sender, envelope.tick].setdefault((name, envelope.sequence), None)

    def done(self, done: TickDone) -> None:
        """Note that an upstream node has ended a tick.

        If several ends of a tick come, the first counts of which all messages are here: those that promise more than
        was sent would be waited for in vain.
        """
        if done.node in self._lags:
            ends = self._ends.get((done.node, done.tick))
            if ends is None:
                ends = self._ends[done.node, done.tick] = deque(maxlen=_ENDS)
            ends.append(done)

    def take(self, stamp_ns: int = 0) -> Ready | None:
        """Return the next step's inputs and advance to the next tick, or None while a message is missing.

        The source of the run sets the time by ``stamp_ns``; other nodes get it from their upstream nodes.
        """
        needed = []
        for node, lag in self._lags.items():
            if self.tick >= lag:
                done = self._ended(node, self.tick - lag)
                if done is None:
                    return None
                needed.append(done)
        arrived: list[Received] = []
        last = False
        for done in needed:
            arrived += self._promised(done)
            del self._ends[done.node, done.tick]
            if done.tick == self.tick:
                stamp_ns, last = done.stamp_ns, last or done.last
        ready = Ready(self.tick, stamp_ns, self._through_link(arrived, stamp_ns), last)
        self.tick += 1
        return ready

    def freeze(self, _now_ns: int = 0) -> FrozenInbox:
        """Return the state between two steps, without the messages that wait for the next one."""
        held = tuple(_held(due_ns, received, self._graph.topics) for due_ns, received in self._late)
        return FrozenInbox(tick=self.tick, next=dict(self._next), held=held)

    def thaw(self, frozen: FrozenInbox, _now_ns: int = 0) -> None:
        """Restore a state that ``freeze`` returned; raises BadMessageError for a message that cannot be decoded."""
        self.tick = frozen.tick
        self._next.update(frozen.next)
        self._late = [(held.due_ns, _received(held, self._graph.topics)) for held in frozen.held]

    def _ended(self, node: str, tick: int) -> TickDone | None:
        ends = self._ends.get((node, tick))
        if ends is None:
            return None
        return next((done for done in ends if self._complete(done)), None)

    def _complete(self, done: TickDone) -> bool:
        here = self._messages.get((done.node, done.tick), {})
        for name, count in done.counts.items():
            if name in self._reads:
                first = self._next[name]
                if count > len(here) or not all((name, first + index) in here for index in range(count)):
                    return False
        return True

    def _promised(self, done: TickDone) -> list[Received]:
        """Remove and return the messages of a complete tick; those whose content was refused are lacking."""
        here = self._messages.pop((done.node, done.tick), {})
        promised = []
        for name, count in done.counts.items():
            if name in self._reads:
                first = self._next[name]
                self._next[name] = first + count
                found = [here[name, sequence] for sequence in range(first, first + count)]
                promised += [received for received in found if received is not None]
        return promised

    def _through_link(self, arrived: list[Received], stamp_ns: int) -> list[Received]:
        on_time = self._delayed(arrived, stamp_ns) if self._link.faulty else arrived
        order = self._graph.input_order
        return sorted(on_time, key=lambda received: order(received.topic, received.node, received.sequence))

    def _delayed(self, arrived: list[Received], stamp_ns: int) -> list[Received]:
        """Return the messages that have come through the link by ``stamp_ns``."""
        for received in arrived:
            delay_ns = self._link.delay_ns(received.topic, received.sequence, received.stamp_ns)
            if delay_ns is not None:
                self._late.append((received.stamp_ns + delay_ns if delay_ns else 0, received))
        on_time = [received for due_ns, received in self._late if due_ns <= stamp_ns]
        self._late = [(due_ns, received) for due_ns, received in self._late if due_ns > stamp_ns]
        return on_time


class RealtimeInbox:
    """Gives the node all messages that have arrived as soon as one of them triggers it, by the wall clock."""

    def __init__(self, graph: Graph, node: str, link: FaultyLink) -> None:
        self._source, self._topics = graph.source, graph.topics
        self._reads = graph.specs[node].reads
        self._upstream = frozenset(graph.lags[node])
        self._leaps: set[str] = set()  # nodes of which the end of any tick may come next
        self._running = {upstream for upstream, lag in graph.lags[node].items() if lag == 0}
        self._link = link
        self._seen: defaultdict[tuple[str, str], SeenNumbers] = defaultdict(SeenNumbers)
        self._ends: defaultdict[str, int] = defaultdict(int)  # node -> ticks that it has ended
        self._arrived: list[Received] = []
        self._late: list[tuple[int, int, Received]] = []
        self._count = 0
        self._stamp_ns = 0
        self.tick = 0

    def admit(self, name: str, sender: str, envelope: Envelope) -> None:
        """Raise OrderError for a message that has come before, or is far ahead of its sender."""
        _check_read(name, self._reads)
        self._seen[sender, name].take(envelope.sequence)

    def admit_end(self, done: TickDone) -> None:
        """Raise OrderError for an end of another tick than the node's next."""
        ahead = done.tick - self._ends[done.node]
        if ahead < 0 or (ahead > 0 and done.node not in self._leaps):
            raise _order(ahead)(f"the end of tick {done.tick}; expected that of {self._ends[done.node]}")
        self._ends[done.node] = done.tick + 1
        self._leaps.discard(done.node)

    def deliver(self, received: Received, _tick: int, now_ns: int) -> None:
        """Add a message, unless the link loses it."""
        delay_ns = self._link.delay_ns(received.topic, received.sequence, received.stamp_ns)
        if delay_ns is not None:
            self._count += 1
            heapq.heappush(self._late, (now_ns + delay_ns, self._count, received))

    def deliver_refused(self, name: str, sender: str, envelope: Envelope) -> None:
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

    def missed(self) -> None:
        """Note that somebody was away: of what comes next, any number before may have been missed."""
        for seen in self._seen.values():
            seen.leap()
        self._seen.default_factory = SeenNumbers.leaping
        self._leaps = {*self._upstream}

    def took(self, ready: Ready) -> None:
        """Note a step that an earlier start of the node has made."""
        self.tick, self._stamp_ns = ready.tick + 1, ready.stamp_ns
        for received in ready.inputs:
            sender = self._source if received.node == LOG_NODE else received.node
            self._seen[sender, received.topic].close(received.sequence)

    def forget_late(self) -> list[Received]:
        """Forget the messages that the link delays: with the node they are lost. Return them."""
        late, self._late = [received for _, _, received in self._late], []
        return late

    def freeze(self, now_ns: int) -> FrozenInbox:
        """Return the state right after a step; delayed messages are due after a duration from ``now_ns``."""
        late = sorted(self._late)
        return FrozenInbox(
            tick=self.tick,
            held=tuple(_held(max(0, due_ns - now_ns), received, self._topics) for due_ns, _, received in late),
            stamp_ns=self._stamp_ns,
            seen=tuple(Seen(*source, *seen.freeze()) for source, seen in sorted(self._seen.items())),
            ends=dict(self._ends),
            running=tuple(sorted(self._running)),
        )

    def thaw(self, frozen: FrozenInbox, now_ns: int) -> None:
        """Restore a state that ``freeze`` returned; raises BadMessageError for a message that cannot be decoded."""
        self.tick, self._stamp_ns = frozen.tick, frozen.stamp_ns
        self._count = len(frozen.held)
        self._late = [
            (now_ns + held.due_ns, number, _received(held, self._topics))
            for number, held in enumerate(frozen.held, start=1)
        ]  # sorted, and so a heap
        for one in frozen.seen:
            self._seen[one.node, one.topic].thaw(one.next, one.open)
        self._ends.update(frozen.ends)
        self._running &= {*frozen.running}

    def _arrive(self, now_ns: int) -> None:
        while self._late and self._late[0][0] <= now_ns:
            self._arrived.append(heapq.heappop(self._late)[2])

    def _take(self, *, last: bool) -> Ready:
        inputs, self._arrived = _fresh(self._arrived, self._topics), []
        self._stamp_ns = max([self._stamp_ns, *(received.stamp_ns for received in inputs)])
        self.tick += 1
        return Ready(self.tick - 1, self._stamp_ns, inputs, last)


def _order(ahead: int) -> type[OrderError]:
    """Return the error for a message that is so far ahead of what is expected."""
    return RepeatError if ahead < 0 else OrderError


def _check_read(name: str, reads: Container[str]) -> None:
    """Raise OrderError for a topic that the node does not read: nobody sends it those."""
    if name not in reads:
        raise OrderError(f"{name} is no topic that this node reads")


def _held(due_ns: int, received: Received, topics: Mapping[str, Topic]) -> Held:
    topic, node, boot, sequence, stamp_ns, message = received
    return Held(due_ns, topic, node, boot, sequence, stamp_ns, encode(topic, message, topics))


def _received(held: Held, topics: Mapping[str, Topic]) -> Received:
    message = decode(held.topic, held.payload, topics)
    return Received(held.topic, held.node, held.boot, held.sequence, held.stamp_ns, message)


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
