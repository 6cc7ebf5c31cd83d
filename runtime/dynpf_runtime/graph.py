"""The graph of a run: its nodes, their order in a tick, and which node waits for which.

It follows from the topics that the nodes read and write, and is known without building any node.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

from dynpf_protocol.keys import OPERATOR
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE, NODES, TOPICS, Topic
from msgspec import structs

from dynpf_runtime.node import Node

__all__ = ["Graph", "NodeSpec", "topic_table"]


class NodeSpec(NamedTuple):
    """The description of a node; ``build`` creates it in its first state, and raises if its parameters are wrong.

    A node names its topics as if it were the only one of its kind: ``reads`` maps each topic that it reads to its own
    name for it, ``writes`` maps each of its own names to the topic that it writes.
    """

    name: str
    kind: str  # nodes of one kind call the same kernels
    build: Callable[[], Node]
    reads: Mapping[str, str]  # topic -> the node's own name for it
    writes: Mapping[str, Topic]  # the node's own name -> topic


class Graph:
    """Nodes in tick order; the first is the source of the run, which is its clock.

    ``topics`` are those of the run by name, each with its publishers: nodes, the log, hosts or the recorder. Their
    order is the order of a step's inputs.
    """

    def __init__(self, specs: Sequence[NodeSpec]) -> None:
        self.specs = {spec.name: spec for spec in specs}
        self.topics = topic_table(specs)
        self._topic_rank = {name: rank for rank, name in enumerate(self.topics)}
        self._node_rank = {name: rank for rank, name in enumerate((*self.specs, LOG_NODE))}

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes' names in tick order."""
        return tuple(self.specs)

    @property
    def source(self) -> str:
        """The name of the node that is the run's clock."""
        return self.nodes[0]

    @cached_property
    def lags(self) -> Mapping[str, Mapping[str, int]]:
        """The nodes that each node waits for: lag 0 for their output of this tick, 1 for that of the previous tick."""
        source, *others = self.nodes
        lags = {name: self._upstream(name) for name in others}
        # Tick k + 1 begins only after every node has ended tick k. If another node waits for a node within the tick,
        # that node has ended when the waiting one has: the source waits for the rest, and for those that it reads.
        waited_for = {writer for upstream in lags.values() for writer, lag in upstream.items() if lag == 0}
        ends = (set(others) - waited_for) | self._writers(source)
        return {source: {name: 1 for name in others if name in ends}, **lags}

    @cached_property
    def awaited(self) -> frozenset[str]:
        """The topics that some node reads."""
        return frozenset().union(*(spec.reads for spec in self.specs.values()))

    def unread(self, name: str) -> int:
        """Return how many of a node's last ticks others may not have read yet when all have ended the same tick."""
        return max(upstream.get(name, 0) for upstream in self.lags.values())

    def subscribed(self, name: str) -> list[str]:
        """Return the topics that a node reads and other nodes write."""
        reads = sorted(self.specs[name].reads)
        return [topic for topic in reads if {*self._publishers(topic)} - {name}]

    @cached_property
    def acts(self) -> frozenset[str]:
        """The topics of a person's acts that some node reads, and that the source's host publishes."""
        read = [topic for spec in self.specs.values() for topic, own in spec.reads.items() if own in _ACT_TOPICS]
        return frozenset(read)

    @cached_property
    def waking_records(self) -> frozenset[str]:
        """The topics of a log whose records begin a tick, because a node that reads them steps on them."""
        read = [self.topics[topic] for topic in self.awaited if topic in self.topics]
        return frozenset(row.name for row in read if row.publishers == (LOG_NODE,) and row.wakes)

    def input_order(self, topic: str, node: str, sequence: int) -> tuple[int, int, int]:
        """Return the sort key of a step's inputs: rank of topic, rank of sender, sequence number."""
        return self._topic_rank[topic], self._node_rank[node], sequence

    def _upstream(self, name: str) -> dict[str, int]:
        rank = self._node_rank
        writers = self._writers(name)
        if not any(rank[writer] < rank[name] for writer in writers):
            writers.add(self.source)  # a node without inputs in the tick gets the tick from the source
        return {writer: 0 if rank[writer] < rank[name] else 1 for writer in self.nodes if writer in writers}

    def _writers(self, name: str) -> set[str]:
        return {writer for topic in self.specs[name].reads for writer in self._publishers(topic) if writer != name}

    def _publishers(self, topic: str) -> list[str]:
        row = self.topics.get(topic)
        senders = () if row is None else row.publishers
        # The source publishes the records of a log.
        writers = [self.source if name == LOG_NODE else name for name in senders]
        return [writer for writer in writers if writer in self.specs]


def topic_table(specs: Sequence[NodeSpec]) -> dict[str, Topic]:
    """Return the topics of a run by name, each with its publishers, in the order of a step's inputs.

    That is the order of TOPICS, then of the nodes; topics of hosts and the recorder come last.
    """
    rows = {}
    read = defaultdict[str, set[str]](set)  # the names by which nodes read what each calls so
    for spec in specs:
        for name, own in spec.reads.items():
            read[own].add(name)
    for own, row in _LOG_TOPICS.items():
        rows.update({name: structs.replace(row, name=name) for name in sorted({own, *read[own]})})
    for own, row in _ACT_TOPICS.items():
        rows.update({name: structs.replace(row, name=name, publishers=(specs[0].name,)) for name in sorted(read[own])})
    written = [
        ((_RANK.get(own, len(_RANK)), rank, row.name), structs.replace(row, publishers=(spec.name,)))
        for rank, spec in enumerate(specs)
        for own, row in spec.writes.items()
        if own not in _HOST_TOPICS
    ]
    rows.update({row.name: row for _, row in sorted(written, key=lambda pair: pair[0])})
    nodes = tuple(spec.name for spec in specs)
    for name in nodes:
        for prefix, row in _OF_EACH_NODE.items():
            rows[prefix + name] = structs.replace(row, name=prefix + name, publishers=(name,))
    for name, row in _HOST_TOPICS.items():
        senders = tuple(sender for sender in row.publishers if sender not in NODES)
        rows[name] = structs.replace(row, publishers=(*nodes, *senders) if set(NODES) & {*row.publishers} else senders)
    return rows


_RANK = {name: rank for rank, name in enumerate(TOPICS)}
_LOG_TOPICS = {name: row for name, row in TOPICS.items() if row.publishers == (LOG_NODE,)}
_ACT_TOPICS = {name: row for name, row in TOPICS.items() if row.publishers == (OPERATOR,)}
_HOST_TOPICS = {name: TOPICS[name] for name in ("log", "notice", "diagnostics", "recorder/gap", "recorder/restart")}
_OF_EACH_NODE = {prefix: TOPICS[prefix + NODES[0]] for prefix in (EVENT_PREFIX, SNAPSHOT_PREFIX)}
