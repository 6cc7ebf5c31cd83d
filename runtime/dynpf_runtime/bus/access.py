"""Access: what each process of a run may say and hear on the bus, by the graph of the run and its topics.

From it comes the router's access control, which denies everything else. Zenoh drops silently what is denied.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from dynpf_protocol.keys import (
    ACT,
    AGAIN,
    ALIVE,
    BEAT,
    CONTROL,
    DATA,
    JOURNAL,
    OBSERVER,
    OPERATOR,
    READY,
    RECALL,
    RECALLED,
    RECORDED,
    RECORDER,
    ROUTER,
    RUN,
    SCENARIO,
    STOP,
    TICK,
    data_key,
    data_keys,
)
from dynpf_protocol.topics import LOG_NODE, TOPICS

from dynpf_runtime.graph import Graph

__all__ = ["PLAYER", "Grant", "access_control", "grants"]

PLAYER = "player"
"""Who publishes a recording, in the names of the nodes that are in it."""


class Grant(NamedTuple):
    """The keys that a process may use; ``*`` is one part of a key, ``**`` any number of parts."""

    puts: tuple[str, ...] = ()  # publishes
    subscribes: tuple[str, ...] = ()  # hears what others publish
    tokens: tuple[str, ...] = ()  # declares liveliness tokens
    watches: tuple[str, ...] = ()  # sees the liveliness tokens of others
    asks: tuple[str, ...] = ()  # queries, and gets the answers


_PRESENCE = (f"{ALIVE}**", f"{READY}**")
_ALL = (f"{RUN}**", f"{BEAT}**", f"{CONTROL}**")
_HEARD = (*_ALL, f"{RECALLED}**", f"{ACT}**")


_RECORDS = [f"{DATA}**/{name}" for name, row in TOPICS.items() if row.publishers == (LOG_NODE,)]
"""The records of an imported log, which the source publishes, of any robots, whether or not a node reads them."""


def grants(graph: Graph) -> dict[str, Grant]:
    """Return what each process of a run with ``graph`` may do, and what an observer, an operator and a player may.

    The router itself is no client of the bus; what it may do as one is to look whether it is there.
    """
    found = {name: _node(name, graph) for name in graph.nodes}
    found[RECORDER] = Grant(
        puts=(BEAT + RECORDER, STOP + RECORDER, RECORDED, f"{RECALLED}**"),
        subscribes=_ALL,
        tokens=_tokens(RECORDER),
        watches=_PRESENCE,
        asks=(SCENARIO,),
    )
    found[ROUTER] = Grant(subscribes=(f"{BEAT}**",), watches=_PRESENCE)
    found[OBSERVER] = Grant(subscribes=_ALL, watches=_PRESENCE, asks=(SCENARIO,))
    found[PLAYER] = Grant(puts=(f"{DATA}**",))
    found[OPERATOR] = Grant((STOP + OPERATOR, ACT + OPERATOR), _ALL, (f"{ALIVE}{OPERATOR}/*",), _PRESENCE, (SCENARIO,))
    return found


def _node(name: str, graph: Graph) -> Grant:
    writes = [data_key(topic, name) for topic, row in graph.topics.items() if name in row.publishers]
    if name == graph.source:
        writes += _RECORDS
    return Grant(
        puts=(*writes, JOURNAL + name, TICK + name, AGAIN + name, RECALL + name, BEAT + name, STOP + name),
        subscribes=(
            *map(data_keys, graph.subscribed(name)),
            *(TICK + other for other in graph.lags[name]),
            RECALLED + name,
            *((f"{ACT}**",) if name == graph.source else ()),
            f"{BEAT}**",
            f"{CONTROL}**",
        ),
        tokens=_tokens(name),
        watches=_PRESENCE,
        asks=(SCENARIO,),
    )


def _tokens(name: str) -> tuple[str, ...]:
    return f"{ALIVE}{name}/*", f"{READY}{name}/*"


def access_control(granted: Mapping[str, Grant], common_names: Mapping[str, str]) -> dict[str, Any]:
    """Return the table ``access_control`` of the router's Zenoh configuration.

    ``common_names`` has the name in the certificate of each process that has one; the others get nothing.
    """
    rules, policies = [], []
    for name in sorted(granted.keys() & common_names.keys()):
        own = [rule for rule in _rules(name, granted[name]) if rule["key_exprs"]]
        rules += own
        if own:
            policies.append({"rules": [rule["id"] for rule in own], "subjects": [name]})
    named = [name for policy in policies for name in policy["subjects"]]
    subjects = [{"id": name, "cert_common_names": [common_names[name]]} for name in named]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(name: str, grant: Grant) -> list[dict[str, Any]]:
    """Return the rules of a grant: ``ingress`` is what the router takes from the process, ``egress`` what it gives."""
    return [
        _rule(name, "says", "ingress", ["put"], grant.puts),
        # A client sends only what it knows to have a subscriber, who may have subscribed to more than this one key.
        _rule(name, "is heard", "egress", ["declare_subscriber"], _HEARD if grant.puts else ()),
        _rule(name, "listens", "ingress", ["declare_subscriber"], grant.subscribes),
        _rule(name, "hears", "egress", ["put"], grant.subscribes),
        _rule(name, "is there", "ingress", ["liveliness_token"], grant.tokens),
        _rule(name, "looks", "ingress", ["liveliness_query", "declare_liveliness_subscriber"], grant.watches),
        _rule(name, "sees", "egress", ["liveliness_token"], grant.watches),
        _rule(name, "asks", "ingress", ["query"], grant.asks),
        _rule(name, "is answered", "egress", ["declare_queryable", "reply"], grant.asks),
    ]


def _rule(name: str, what: str, flow: str, messages: list[str], keys: Iterable[str]) -> dict[str, Any]:
    return {
        "id": f"{name} {what}",
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": list(keys),
    }
