"""Builds the plan of a run, and its nodes, from a scenario."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import msgspec
from dynpf_formats.shipped import known_topics, load
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.keys import SHARED
from dynpf_protocol.topics import EVENT_PREFIX, NODES, TOPIC_NAME, Topic, is_act
from dynpf_runtime.graph import Graph, NodeSpec
from dynpf_runtime.node import Node
from dynpf_runtime.plan import Plan

from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import node_kind, section_of
from dynpf_services.scenario.order import in_tick_order
from dynpf_services.scenario.problems import nearest
from dynpf_services.scenario.schema import Scenario, key_of, resolved_json
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["build_node", "build_nodes", "plan_of"]


def plan_of(scenario: Scenario) -> Plan:
    """Return the plan of a run; no node is built.

    Raises ScenarioError if nodes do not fit each other, or a fault concerns a topic that its node does not read.
    """
    graph = Graph(in_tick_order(_specs(scenario), _stages(scenario)))
    _check_writers(graph)
    for name, remap in scenario.remaps.items():
        _check_remap(graph, name, remap)
    for index, fault in enumerate(scenario.faults):
        reads = [topic for topic in graph.specs[fault.to].reads if not is_act(topic)]  # those come by no network
        if fault.topic not in reads:
            listed = ", ".join(sorted(reads))
            raise ScenarioError(f"faults.{index}.topic: {fault.to} does not read {fault.topic}; it reads {listed}")
    return Plan(
        graph=graph,
        seed=scenario.seed,
        clock=scenario.clock,
        rate=scenario.rate,
        tick_ns=scenario.tick_ns,
        max_ticks=scenario.max_ticks,
        plays_log=scenario.needs_log,
        state_digest_ticks=scenario.state_digest_ticks,
        faults=scenario.faults,
        text=resolved_json(scenario),
    )


def build_nodes(scenario: Scenario) -> dict[str, Node]:
    """Return the nodes of a run by name, in tick order, each in its first state.

    Raises ScenarioError if a section does not fit the rest.
    """
    return {name: spec.build() for name, spec in plan_of(scenario).graph.specs.items()}


def build_node(scenario: Scenario, name: str) -> Node:
    """Return one node of a run in its first state; raises ScenarioError if its section does not fit the rest."""
    for spec in _specs(scenario):
        if spec.name == name:
            return spec.build()
    raise ScenarioError(f"{name}: takes no part in this run; its nodes are {', '.join(scenario.nodes)}")


def _specs(scenario: Scenario) -> list[NodeSpec]:
    shared: dict[str, Any] = {}
    contexts = [Context(scenario, name, shared) for name in scenario.nodes]
    writes = {context.name: _writes(context) for context in contexts}
    written = [row for rows in writes.values() for row in rows.values()]
    return [
        NodeSpec(
            name=context.name,
            kind=_identity(context),
            build=partial(_built, context, written),
            reads=_reads(context, written),
            writes=writes[context.name],
        )
        for context in contexts
    ]


def _identity(context: Context) -> str:
    """Return a name of the node's kind: the import string, or the class for a user node."""
    config = context.scenario.nodes[context.name]
    return config.name if isinstance(config, UserComponent) else context.scenario.kinds[context.name]


def _names(context: Context) -> "_Names":
    scenario, name = context.scenario, context.name
    return _Names(name, section_of(scenario.kinds[name]), scenario.remaps.get(name, {}))


def _writes(context: Context) -> dict[str, Topic]:
    """Return the topics that a node writes, by the node's own names for them."""
    scenario, names = context.scenario, _names(context)
    try:
        declared = node_kind(scenario.kinds[context.name]).writes(scenario.nodes[context.name], context)
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(f"{key_of(context.name)}: {error}") from error
    rows = declared if isinstance(declared, Mapping) else {own: known_topics()[own] for own in sorted(declared)}
    return {own: msgspec.structs.replace(row, name=names.topic(own)) for own, row in rows.items()}


def _reads(context: Context, written: Sequence[Topic]) -> dict[str, str]:
    """Return the node's own name for each topic that it reads; a type stands for all topics of its robot with it."""
    scenario, names = context.scenario, _names(context)
    found: dict[str, str] = {}
    declared = node_kind(scenario.kinds[context.name]).reads(scenario.nodes[context.name], context)
    user = isinstance(scenario.nodes[context.name], UserComponent)  # whose names of topics nobody else has checked
    choices = [*known_topics(), *(row.name for row in written)] if user else []
    for own in sorted(declared, key=str):  # sets have another order in every process
        if isinstance(own, str):
            topic = names.topic(own)
            if user and {own, topic}.isdisjoint(choices):
                raise ScenarioError(f"{key_of(context.name)}: reads {own}, which no node writes{nearest(own, choices)}")
            if topic in found:
                raise ScenarioError(f"{key_of(context.name)}.remap.{own}: {topic} is its {found[topic]} already")
            found[topic] = own
        else:
            of_type = [row.name for row in written if row.type is own and row.name.startswith(names.namespace)]
            found.update({topic: topic for topic in of_type})
    return found


class _Names:
    """Translates a node's own names for topics to topics.

    A node names its topics as if it were the only one of its kind in the run: ``estimator/state``. For a node ``other``
    that is the topic ``other/state``, and in the namespace of a robot the topic begins with the robot's name.
    """

    def __init__(self, node: str, usual: str, remap: Mapping[str, str]) -> None:
        self._node, self._usual, self._remap = node, usual, remap
        namespace, slash, _ = node.rpartition("/")
        self.namespace = namespace + slash

    def topic(self, own: str) -> str:
        """Return the topic of the node's own name."""
        if own in self._remap:
            return self._remap[own]
        first, slash, rest = own.partition("/")
        if own in _SHARED:
            return own
        if own.startswith(EVENT_PREFIX):
            return EVENT_PREFIX + self._node
        if not slash:
            return f"{self._node}/{own}"
        if first == self._usual:
            return f"{self._node}/{rest}"
        return self.namespace + own


_SHARED = frozenset({"log"})
"""Topics that all nodes of a run write."""

_HOSTS = SHARED | {"event", "journal", "recorder", "snapshot"}
"""First parts of the topics of logs and of hosts."""


def _built(context: Context, written: Sequence[Topic]) -> Node:
    name, scenario = context.name, context.scenario
    build = load(node_kind(scenario.kinds[name]).build)
    try:
        node: Node = build(scenario.nodes[name], context)
    except ScenarioError:
        raise
    except ValueError as error:
        raise ScenarioError(f"{key_of(name)}: {error}") from error
    _check_read(context, written)
    return node


def _stages(scenario: Scenario) -> dict[str, int | None]:
    """Return the stage of each node in a tick by its kind; None for user nodes."""
    sections = {name: section_of(text) for name, text in scenario.kinds.items()}
    return {name: NODES.index(section) if section in NODES else None for name, section in sections.items()}


def _check_writers(graph: Graph) -> None:
    """Raise ScenarioError if two nodes write one topic, or one writes a topic of the log or of hosts."""
    writers: dict[str, str] = {}
    for spec in graph.specs.values():
        for row in spec.writes.values():
            if row.name in _SHARED:
                continue
            first = row.name.partition("/")[0]
            if row.name in writers:
                other = writers[row.name]
                which = "by two of its own names" if other == spec.name else f"which {other} writes already"
                raise ScenarioError(f"{key_of(spec.name)}: writes {row.name}, {which}")
            writers[row.name] = spec.name
            if is_act(row.name) or first in _HOSTS:
                raise ScenarioError(f"{key_of(spec.name)}: writes {row.name}, which nodes must not write")


def _check_remap(graph: Graph, name: str, remap: Mapping[str, str]) -> None:
    """Raise ScenarioError for a remap of a name that the node does not have, or to a topic of another type."""
    spec, key = graph.specs[name], f"{key_of(name)}.remap"
    own_names = [*spec.writes, *spec.reads.values()]
    for own, topic in remap.items():
        if own not in own_names:
            raise ScenarioError(f"{key}: the node has no topic {own!r}{nearest(own, sorted(own_names))}")
        if TOPIC_NAME.fullmatch(topic) is None:
            raise ScenarioError(f"{key}.{own}: {topic!r} is no topic; expected words of a-z, 0-9 and _ with / between")
        expected, found = known_topics().get(own), graph.topics.get(topic)
        if expected is not None and found is not None and found.type is not expected.type:
            raise ScenarioError(
                f"{key}.{own}: {topic} carries {found.type.__name__}; the node expects {expected.type.__name__}"
            )


def _check_read(context: Context, written: Sequence[Topic]) -> None:
    """Raise ScenarioError if no node writes a topic that the node needs."""
    scenario, names = context.scenario, _names(context)
    needs = node_kind(scenario.kinds[context.name]).needs(scenario.nodes[context.name], context)
    for own, key in needs.items():
        what = names.topic(own) if isinstance(own, str) else own.__name__
        offered = (row.name if isinstance(own, str) else row.type for row in written)
        if (what if isinstance(own, str) else own) not in offered:
            raise ScenarioError(f"{key_of(context.name)}.{key}: reads {what}, which no node of this run writes")
