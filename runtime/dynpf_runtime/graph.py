"""The graph of a run: which nodes take part, in which order a tick goes round, and who waits for whom."""

from collections.abc import Mapping, Sequence

import msgspec
from dynpf_protocol.topics import HOST_NODES, NODES, TOPICS

from dynpf_runtime.node import Node

__all__ = ["Graph", "input_order"]

_TOPIC_RANK = {name: rank for rank, name in enumerate(TOPICS)}
_NODE_RANK = {name: rank for rank, name in enumerate(HOST_NODES)}


class Graph(msgspec.Struct, frozen=True):
    """Nodes in tick order; ``lags[node][upstream]`` is 0 for this tick's output and 1 for the previous tick's.

    The first node is the source of the run: it is the clock.
    """

    nodes: tuple[str, ...]
    lags: Mapping[str, Mapping[str, int]]

    @property
    def source(self) -> str:
        return self.nodes[0]

    @classmethod
    def of(cls, nodes: Sequence[Node]) -> "Graph":
        names = tuple(sorted((node.name for node in nodes), key=NODES.index))
        reads = {node.name: node.reads for node in nodes}
        source, *others = names
        lags = {name: _upstream(name, names, reads[name]) for name in others}
        # Tick k + 1 begins only after every node has ended tick k. Whoever another node waits for within the tick has
        # ended when that one has: the source waits for the rest, and for those whose messages it reads.
        waited_for = {writer for upstream in lags.values() for writer, lag in upstream.items() if lag == 0}
        ends = (set(others) - waited_for) | _writers(source, names, reads[source])
        return cls(names, {source: {name: 1 for name in others if name in ends}, **lags})


def _upstream(name: str, names: tuple[str, ...], reads: frozenset[str]) -> dict[str, int]:
    place = names.index(name)
    writers = _writers(name, names, reads)
    if not any(names.index(writer) < place for writer in writers):
        writers.add(names[0])  # somebody has to give it the tick
    return {writer: 0 if names.index(writer) < place else 1 for writer in names if writer in writers}


def _writers(name: str, names: tuple[str, ...], reads: frozenset[str]) -> set[str]:
    return {writer for topic in reads for writer in TOPICS[topic].publishers if writer in names and writer != name}


def input_order(topic: str, node: str, sequence: int) -> tuple[int, int, int]:
    """Return the key by which a step's inputs are ordered: topic table, sender, sequence."""
    return _TOPIC_RANK[topic], _NODE_RANK[node], sequence
