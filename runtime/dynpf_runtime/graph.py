"""The graph of a run: which nodes take part, in which order a tick goes round, and who waits for whom.

It follows from what the nodes read and write, and is known without building any.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE, NODES, TOPICS, Topic
from msgspec import structs

from dynpf_runtime.node import Node

__all__ = ["Graph", "NodeSpec", "topic_table"]


class NodeSpec(NamedTuple):
    """One node of a run before it is built; ``build`` makes it in its first state and raises what is wrong with it.

    A node names its topics as if it were the only one of its kind: ``reads`` has its own name for each topic that it
    reads, ``writes`` the topic that each of its own names stands for that it writes to.
    """

    name: str
    kind: str  # what it is; nodes of one kind call the same kernels
    build: Callable[[], Node]
    reads: Mapping[str, str]  # topic -> the node's own name for it
    writes: Mapping[str, Topic]  # the node's own name -> topic


class Graph:
    """Nodes in tick order; the first is the source of the run: it is the clock.

    ``topics`` are those of the run, by name, each with its publishers among the nodes (and the log, host or recorder);
    their order is the order of a step's inputs.
    """

    def __init__(self, specs: Sequence[NodeSpec]) -> None:
        self.specs = {spec.name: spec for spec in specs}
        self.topics = topic_table(specs)
        self._topic_rank = {name: rank for rank, name in enumerate(self.topics)}
        self._node_rank = {name: rank for rank, name in enumerate((*self.specs, LOG_NODE))}

    @property
    def nodes(self) -> tuple[str, ...]:
        return tuple(self.specs)

    @property
    def source(self) -> str:
        return self.nodes[0]

    @cached_property
    def lags(self) -> Mapping[str, Mapping[str, int]]:
        """Whom each node waits for: 0 for this tick's output, 1 for the previous tick's."""
        source, *others = self.nodes
        lags = {name: self._upstream(name) for name in others}
        # Tick k + 1 begins only after every node has ended tick k. Whoever another node waits for within the tick has
        # ended when that one has: the source waits for the rest, and for those whose messages it reads.
        waited_for = {writer for upstream in lags.values() for writer, lag in upstream.items() if lag == 0}
        ends = (set(others) - waited_for) | self._writers(source)
        return {source: {name: 1 for name in others if name in ends}, **lags}

    @cached_property
    def awaited(self) -> frozenset[str]:
        """The topics that some node reads."""
        return frozenset().union(*(spec.reads for spec in self.specs.values()))

    def subscribed(self, name: str) -> list[str]:
        """Return the topics that a node reads and another node writes."""
        reads = sorted(self.specs[name].reads)
        return [topic for topic in reads if {*self._publishers(topic)} - {name}]

    @cached_property
    def waking_records(self) -> frozenset[str]:
        """The records of a log that begin a tick: a node that reads them steps when they come."""
        read = [self.topics[topic] for topic in self.awaited if topic in self.topics]
        return frozenset(row.name for row in read if row.publishers == (LOG_NODE,) and row.wakes)

    def input_order(self, topic: str, node: str, sequence: int) -> tuple[int, int, int]:
        """Return the key by which a step's inputs are ordered: topic table, sender, sequence."""
        return self._topic_rank[topic], self._node_rank[node], sequence

    def _upstream(self, name: str) -> dict[str, int]:
        rank = self._node_rank
        writers = self._writers(name)
        if not any(rank[writer] < rank[name] for writer in writers):
            writers.add(self.source)  # somebody has to give it the tick
        return {writer: 0 if rank[writer] < rank[name] else 1 for writer in self.nodes if writer in writers}

    def _writers(self, name: str) -> set[str]:
        return {writer for topic in self.specs[name].reads for writer in self._publishers(topic) if writer != name}

    def _publishers(self, topic: str) -> list[str]:
        row = self.topics.get(topic)
        senders = () if row is None else row.publishers
        # Whoever reads a log's records has them from the source, which feeds them in.
        writers = [self.source if name == LOG_NODE else name for name in senders]
        return [writer for writer in writers if writer in self.specs]


def topic_table(specs: Sequence[NodeSpec]) -> dict[str, Topic]:
    """Return the topics of a run by name, each with who publishes it, in the order in which a step's inputs are taken.

    That is the order of TOPICS, then of the nodes; what hosts and the recorder say comes last.
    """
    rows = {}
    for own, row in _LOG_TOPICS.items():
        read = {name for spec in specs for name, known in spec.reads.items() if known == own}
        rows.update({name: structs.replace(row, name=name) for name in sorted({own, *read})})
    written = [
        ((_RANK.get(own, len(_RANK)), place, row.name), structs.replace(row, publishers=(spec.name,)))
        for place, spec in enumerate(specs)
        for own, row in spec.writes.items()
        if own not in _HOST_TOPICS
    ]
    rows.update({row.name: row for _, row in sorted(written, key=lambda pair: pair[0])})
    nodes = tuple(spec.name for spec in specs)
    for name in nodes:
        rows[EVENT_PREFIX + name] = structs.replace(_EVENT, name=EVENT_PREFIX + name, publishers=(name,))
    for name, row in _HOST_TOPICS.items():
        senders = tuple(sender for sender in row.publishers if sender not in NODES)
        rows[name] = structs.replace(row, publishers=(*nodes, *senders) if set(NODES) & {*row.publishers} else senders)
    return rows


_RANK = {name: rank for rank, name in enumerate(TOPICS)}
_LOG_TOPICS = {name: row for name, row in TOPICS.items() if row.publishers == (LOG_NODE,)}
_HOST_TOPICS = {name: TOPICS[name] for name in ("log", "diagnostics", "recorder/gap")}
_EVENT = next(row for name, row in TOPICS.items() if name.startswith(EVENT_PREFIX))
