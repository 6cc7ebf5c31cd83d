"""Feeds of a run's source: a clock gives ticks of equal length, an imported log one tick per sensor record."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, Protocol

from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.messages import HostEvent
from dynpf_protocol.topics import LOG_NODE, is_act

from dynpf_runtime.executor import Sent
from dynpf_runtime.graph import Graph
from dynpf_runtime.node import Received

__all__ = ["Feed", "LiveBatch", "LiveFeeds", "LiveSource", "LogRecord", "feed_log", "feed_ticks", "is_fed"]


class Feed(NamedTuple):
    """The beginning of a tick: its time, the log's messages to publish, and those that the source consumes."""

    stamp_ns: int
    sent: tuple[Sent, ...]
    inputs: tuple[Received, ...]
    last: bool
    gaps: tuple[HostEvent, ...] = ()  # records that a live robot has sent, and that never came


class LogRecord(NamedTuple):
    """One record of an imported log, in file order."""

    topic: str
    stamp_ns: int
    payload: bytes


class _Named(Protocol):
    @property
    def node(self) -> str: ...

    @property
    def topic(self) -> str: ...


def is_fed(message: _Named) -> bool:
    """Return whether a message that a host has published was given to its node: a log's record, or a person's act."""
    return message.node == LOG_NODE or is_act(message.topic)


def feed_ticks(tick_ns: int, max_ticks: int) -> Iterator[Feed]:
    """Yield ticks of equal length, from time 0."""
    for tick in range(max_ticks):
        yield Feed(tick * tick_ns, (), (), tick + 1 == max_ticks)


class LiveBatch(NamedTuple):
    """Records of a live robot for one tick, the last of which begins it, and those that never came."""

    records: tuple[LogRecord, ...]
    gaps: tuple[HostEvent, ...]


class LiveSource(Protocol):
    """The records of a live robot as they arrive."""

    @property
    def waiting(self) -> bool:
        """Whether something has arrived that was not taken."""

    def take(self) -> LiveBatch | None:
        """Return the records of the next tick, None while no record has come that begins one."""


class _Records:
    """Numbers the records of a log, and makes feeds of them."""

    def __init__(self, graph: Graph, boot: str) -> None:
        self._reads, self._topics, self._boot = graph.specs[graph.source].reads, graph.topics, boot
        self._sequences: defaultdict[str, int] = defaultdict(int)

    def go_on(self, numbers: Mapping[str, int]) -> None:
        """Give the next record of each topic this number."""
        self._sequences.update(numbers)

    def feed(self, records: Iterable[LogRecord], stamp_ns: int, *, tick: int, publish_ns: int, last: bool) -> Feed:
        sent = []
        for record in records:
            sequence = self._sequences[record.topic]
            envelope = Envelope(LOG_NODE, self._boot, sequence, tick, record.stamp_ns, publish_ns)
            self._sequences[record.topic] += 1
            sent.append(Sent(record.topic, envelope, record.payload))
        inputs = tuple(
            Received(
                message.topic,
                LOG_NODE,
                self._boot,
                message.envelope.sequence,
                message.envelope.stamp_ns,
                decode(message.topic, message.payload, self._topics),
            )
            for message in sent
            if message.topic in self._reads
        )
        return Feed(stamp_ns, tuple(sent), inputs, last)


class LiveFeeds:
    """The feeds of a live robot: a tick for each record that begins one, as soon as it is here.

    The time of a tick is that of its record, or the tick's before if a record comes late.
    """

    def __init__(self, source: LiveSource, graph: Graph, *, boot: str, max_ticks: int) -> None:
        self._source, self._records, self._max_ticks = source, _Records(graph, boot), max_ticks
        self._tick = self._stamp_ns = 0

    def go_on(self, ticks: int, stamp_ns: int, numbers: Mapping[str, int]) -> None:
        """Go on after so many ticks, the last of this time, with these next numbers of the records."""
        self._tick, self._stamp_ns = ticks, stamp_ns
        self._records.go_on(numbers)

    @property
    def waiting(self) -> bool:
        """Whether something has arrived."""
        return self._source.waiting

    def next(self, publish_ns: int, *, stopping: bool) -> Feed | None:
        """Return the feed of the next tick, None while there is none; if the run is to end, the last one at once."""
        batch = self._source.take()
        if batch is None:
            if not stopping:
                return None
            batch = LiveBatch((), ())
        self._stamp_ns = max([self._stamp_ns, *(record.stamp_ns for record in batch.records[-1:])])
        last = stopping or self._tick + 1 == self._max_ticks
        feed = self._records.feed(batch.records, self._stamp_ns, tick=self._tick, publish_ns=publish_ns, last=last)
        self._tick += 1
        return feed._replace(gaps=batch.gaps)


def feed_log(
    records: Iterable[LogRecord], graph: Graph, *, boot: str, publish_ns: int, max_ticks: int
) -> Iterator[Feed]:
    """Yield one tick for each record that wakes a node; records in between belong to the next tick.

    Records after the last waking one belong to the last tick. A log without waking records gives no tick.
    """
    numbered = _Records(graph, boot)
    batch: list[LogRecord] = []
    waiting: tuple[list[LogRecord], LogRecord] | None = None
    tick = 0

    def feed(records: list[LogRecord], trigger: LogRecord, *, last: bool) -> Feed:
        return numbered.feed(records, trigger.stamp_ns, tick=tick, publish_ns=publish_ns, last=last)

    for record in records:
        batch.append(record)
        if record.topic not in graph.waking_records:
            continue
        if waiting is not None:
            yield feed(*waiting, last=tick + 1 == max_ticks)
            tick += 1
            if tick == max_ticks:
                return
        waiting, batch = (batch, record), []
    if waiting is not None:
        last_batch, trigger = waiting
        yield feed([*last_batch, *batch], trigger, last=True)
