"""Consumption: whether each step has read what was sent to it, by the ends of ticks and the journal.

In lockstep what a step reads follows from what the nodes upstream have sent. A step that has read less or more was
given something else: a stranger's word came before the true one.
"""

from collections import deque

from dynpf_protocol.control import TickDone
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.topics import LOG_NODE

from dynpf_runtime.plan import Plan

__all__ = ["Consumption"]

_WINDOW = 1000
"""How many steps of each node are remembered."""


class Consumption:
    """Compares the steps of a run of ``plan`` as they are written, in whatever order the nodes' steps come.

    Nothing is compared in realtime, nor what comes over a link with injected faults.
    """

    def __init__(self, plan: Plan) -> None:
        graph = plan.graph
        self._source = graph.source
        self._lags = graph.lags if plan.clock == "lockstep" else {}
        faulty = {name: {fault.topic for fault in plan.faults if fault.to == name} for name in graph.nodes}
        self._reads = {name: frozenset(spec.reads) - faulty[name] for name, spec in graph.specs.items()}
        self._sent: dict[str, dict[int, dict[str, int]]] = {name: {} for name in graph.nodes}
        self._waiting: deque[tuple[str, int, dict[str, int]]] = deque()

    def wrote(self, name: str, end: TickDone, entry: JournalEntry) -> str:
        """Note a step of a node, and return a sentence on a step that has not read what was sent to it, or ""."""
        if not self._lags:
            return ""
        sent = self._sent[name]
        sent[end.tick] = end.counts
        sent.pop(end.tick - _WINDOW, None)
        reads = self._reads[name]
        own = {name, LOG_NODE} if name == self._source else {name}  # what its own host has given to it
        read: dict[str, int] = {}
        for ref in entry.consumed:
            if ref.topic in reads and ref.node not in own:
                read[ref.topic] = read.get(ref.topic, 0) + 1
        self._waiting.append((name, end.tick, read))
        return self._compare()

    def _compare(self) -> str:
        """Compare the steps of which all that was sent to them is known."""
        doubt = ""
        for _ in range(len(self._waiting)):
            name, tick, read = self._waiting.popleft()
            expected = self._expected(name, tick)
            if expected is None:
                self._waiting.append((name, tick, read))
            elif expected != read:
                doubt = doubt or f"step {tick} of {name} has not read what was sent to it"
        return doubt

    def _expected(self, name: str, tick: int) -> dict[str, int] | None:
        """Return how many messages of each topic a step reads, or None while a node upstream has not come so far."""
        reads = self._reads[name]
        expected: dict[str, int] = {}
        for upstream, lag in self._lags[name].items():
            if tick >= lag:
                counts = self._sent[upstream].get(tick - lag)
                if counts is None:
                    return None
                for topic, count in counts.items():
                    if topic in reads:
                        expected[topic] = expected.get(topic, 0) + count
        return expected
