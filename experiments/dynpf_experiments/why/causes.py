"""Causes: what can be left out of a run: a scheduled event, a fault, or a stretch of an input or a decision."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
from dynpf_protocol.messages import Estimate
from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.schema import Scenario, key_of

__all__ = ["Cause", "Event", "Stretch", "Way", "events_of", "ways_of", "without"]


class Event(NamedTuple):
    """An entry of a list in a scenario: of a node's table, with the tick of which it tells, or of its faults."""

    node: str  # "" for a fault
    field: str
    number: int  # in the list
    tick: int  # the first in which it can have an effect

    @property
    def key(self) -> str:
        """Its key in the scenario."""
        return f"{key_of(self.node)}.{self.field}.{self.number}" if self.node else f"{self.field}.{self.number}"


class Way(NamedTuple):
    """A way that messages take: a topic to some nodes; ``kind`` is "input" of an estimator, or "decision"."""

    topic: str
    kind: str
    to: tuple[str, ...]


class Stretch(NamedTuple):
    """The messages of a way in the ticks from ``first`` to ``last``."""

    way: Way
    first: int
    last: int

    @property
    def key(self) -> str:
        """Its topic."""
        return self.way.topic


Cause = Event | Stretch


def events_of(scenario: Scenario) -> list[Event]:
    """Return the events of a scenario in order of their ticks: faults, and what in a node's table has a ``tick``."""
    found = [Event("", "faults", index, 0) for index in range(len(scenario.faults))]
    for node, config in scenario.nodes.items():
        for field, index, tick in _scheduled(config):
            found.append(Event(node, field, index, tick))
    return sorted(found, key=lambda event: event.tick)


def _scheduled(config: object) -> Iterator[tuple[str, int, int]]:
    if not isinstance(config, msgspec.Struct):
        return
    for field in config.__struct_fields__:
        value = getattr(config, field)
        if not isinstance(value, tuple):
            continue
        for index, entry in enumerate(value):
            if isinstance(entry, msgspec.Struct) and isinstance(tick := getattr(entry, "tick", None), int):
                yield field, index, tick


def without(scenario: Scenario, event: Event) -> Scenario:
    """Return a scenario without one of its events."""
    if not event.node:
        return scenario.changed(faults=_shortened(scenario.faults, event.number))
    config = scenario.nodes[event.node]
    shorter = _shortened(getattr(config, event.field), event.number)
    return scenario.changed(**{event.node: msgspec.structs.replace(config, **{event.field: shorter})})


def _shortened(entries: Sequence[object], index: int) -> tuple[object, ...]:
    return (*entries[:index], *entries[index + 1 :])


def ways_of(plan: Plan) -> list[Way]:
    """Return the ways whose messages can be left out: what the source decides by, and what estimators read.

    In a run that plays a log these are the log's records, but the reference.
    """
    graph = plan.graph
    if plan.plays_log:
        read = [topic for topic in graph.topics if topic in graph.specs[graph.source].reads]
        records = [topic for topic in read if graph.topics[topic].publishers == (LOG_NODE,)]
        return [Way(topic, "input", (graph.source,)) for topic in records]
    estimators = {row.publishers[0] for row in graph.topics.values() if row.type is Estimate and row.publishers}
    ways = []
    for topic, row in graph.topics.items():
        if topic.startswith(EVENT_PREFIX) or not row.publishers:
            continue
        readers = [name for name in graph.nodes if topic in graph.specs[name].reads and name not in row.publishers]
        if graph.source in readers:
            ways.append(Way(topic, "decision", (graph.source,)))
        elif inputs := tuple(name for name in readers if name in estimators):
            ways.append(Way(topic, "input", inputs))
    return ways
