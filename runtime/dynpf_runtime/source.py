"""Sources: what begins a tick. The simulator counts ticks; an imported log gives one tick for each sensor record."""

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
    """One tick's beginning: its time, the log messages to be published, and those of them that the node consumes."""

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
    """Yield one tick for each record that wakes a node; other records ride along with the next such one.

    Records that follow the last such one ride along with the last tick. Nothing is yielded for a log without any.
    """
    reads, topics = graph.specs[graph.source].reads, graph.topics
    sequences: defaultdict[str, int] = defaultdict(int)
    riding: list[LogRecord] = []
    waiting: tuple[list[LogRecord], LogRecord] | None = None
    tick = 0

    def feed(batch: list[LogRecord], trigger: LogRecord, *, last: bool) -> Feed:
        sent = []
        for record in batch:
            envelope = Envelope(LOG_NODE, boot, sequences[record.topic], tick, record.stamp_ns, publish_ns)
            sequences[record.topic] += 1
            sent.append(Sent(record.topic, envelope, record.payload))
        inputs = tuple(
            Received(
                one.topic,
                LOG_NODE,
                boot,
                one.envelope.sequence,
                one.envelope.stamp_ns,
                decode(one.topic, one.payload, topics),
            )
            for one in sent
            if one.topic in reads
        )
        return Feed(trigger.stamp_ns, tuple(sent), inputs, last)

    for record in records:
        riding.append(record)
        if record.topic not in graph.waking_records:
            continue
        if waiting is not None:
            yield feed(*waiting, last=tick + 1 == max_ticks)
            tick += 1
            if tick == max_ticks:
                return
        waiting, riding = (riding, record), []
    if waiting is not None:
        batch, trigger = waiting
        yield feed([*batch, *riding], trigger, last=True)
