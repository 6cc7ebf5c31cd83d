"""Feeds of a run's source: a clock gives ticks of equal length, an imported log one tick per sensor record."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from dynpf_protocol.codec import decode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.topics import LOG_NODE

from dynpf_runtime.executor import Sent
from dynpf_runtime.graph import Graph
from dynpf_runtime.node import Received

__all__ = ["Feed", "LogRecord", "feed_log", "feed_ticks"]


class Feed(NamedTuple):
    """The beginning of a tick: its time, the log's messages to publish, and those that the source consumes."""

    stamp_ns: int
    sent: tuple[Sent, ...]
    inputs: tuple[Received, ...]
    last: bool


class LogRecord(NamedTuple):
    """One record of an imported log, in file order."""

    topic: str
    stamp_ns: int
    payload: bytes


def feed_ticks(tick_ns: int, max_ticks: int) -> Iterator[Feed]:
    """Yield ticks of equal length, from time 0."""
    for tick in range(max_ticks):
        yield Feed(tick * tick_ns, (), (), tick + 1 == max_ticks)


def feed_log(
    records: Iterable[LogRecord], graph: Graph, *, boot: str, publish_ns: int, max_ticks: int
) -> Iterator[Feed]:
    """Yield one tick for each record that wakes a node; records in between belong to the next tick.

    Records after the last waking one belong to the last tick. A log without waking records gives no tick.
    """
    reads, topics = graph.specs[graph.source].reads, graph.topics
    sequences: defaultdict[str, int] = defaultdict(int)
    batch: list[LogRecord] = []
    waiting: tuple[list[LogRecord], LogRecord] | None = None
    tick = 0

    def feed(records: list[LogRecord], trigger: LogRecord, *, last: bool) -> Feed:
        sent = []
        for record in records:
            envelope = Envelope(LOG_NODE, boot, sequences[record.topic], tick, record.stamp_ns, publish_ns)
            sequences[record.topic] += 1
            sent.append(Sent(record.topic, envelope, record.payload))
        inputs = tuple(
            Received(
                message.topic,
                LOG_NODE,
                boot,
                message.envelope.sequence,
                message.envelope.stamp_ns,
                decode(message.topic, message.payload, topics),
            )
            for message in sent
            if message.topic in reads
        )
        return Feed(trigger.stamp_ns, tuple(sent), inputs, last)

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
