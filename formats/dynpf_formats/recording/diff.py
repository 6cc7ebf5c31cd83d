"""Compares two recordings and finds the first difference: in which message of which tick, and in which field."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import zip_longest
from typing import Any

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.json_text import read_json
from dynpf_protocol.topics import LOG_NODE, NODES

from dynpf_formats.recording.digest import Key, Leaf, StateKey, StepKey, StepLine, leaves, states, steps
from dynpf_formats.recording.reader import Recording
from dynpf_formats.shipped import known_topics

__all__ = ["Difference", "FirstDifference", "TopicCounts", "diff", "first_field", "order_of"]

_SHOWN = 80  # characters of a text

_LAST = 2**63

_Order = tuple[int, int, int, str, int, str, int, int]


class FirstDifference(msgspec.Struct, frozen=True, kw_only=True):
    """The first message, or state, that differs.

    ``field`` is the path inside the message, such as ``pose.x``; or ``tick``, ``stamp_ns``, ``state``, ``message``
    (one side lacks it), ``consumed[i]`` or ``produced[i]`` (the step consumed or produced another message at index i)
    or ``payload`` (other bytes, the same values). ``tick`` is None if no journal has it.
    """

    node: str
    topic: str
    tick: int | None
    sequence: int
    field: str
    a: Any
    b: Any


class TopicCounts(msgspec.Struct, frozen=True, kw_only=True):
    """The number of messages of a topic in each recording, and how many differ or lack their counterpart."""

    a: int
    b: int
    differ: int


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a comparison, as ``dynpf diff --json`` prints it but for the measures."""

    same: bool
    first: FirstDifference | None
    counts: dict[str, TopicCounts]


def diff(a: Recording, b: Recording) -> Difference:
    """Compare two recordings by what their content digests cover.

    Differences are ordered by tick, then by the order of the nodes in a tick, then of the topic table, then by sequence
    number; steps that differ although all messages and states are equal come last. Two recordings are the same exactly
    if their content digests are.
    """
    left, right = leaves(a), leaves(b)
    ranks = _node_ranks(a, b)
    left_states, right_states = states(a), states(b)
    keys = [key for key in {**left, **right} if _differ(left.get(key), right.get(key))]
    state_keys = [key for key in {**left_states, **right_states} if left_states.get(key) != right_states.get(key)]
    found: list[tuple[_Order, Key | StateKey]] = [
        (_order(ranks, key, left.get(key), right.get(key)), key) for key in keys
    ]
    found += [(_state_order(ranks, key, left_states.get(key), right_states.get(key)), key) for key in state_keys]
    first: FirstDifference | None = None
    if found:
        _, key = min(found)
        if isinstance(key, StateKey):
            first = _state_difference(key, left_states.get(key), right_states.get(key))
        else:
            first = _message_difference(key, left.get(key), right.get(key))
    first = first or _step_difference(ranks, steps(a), steps(b))
    return Difference(same=first is None, first=first, counts=_counts(left, right, keys))


def order_of(first: FirstDifference, nodes: Sequence[str]) -> tuple[bool, int, int, int, str, int]:
    """Return a key by which first differences of runs with these ``nodes`` are sorted as ``diff`` sorts them.

    Its first value says whether the difference is one of steps alone, which come after all others.
    """
    ranks = {node: rank for rank, node in enumerate((LOG_NODE, *nodes))}
    of_journal = first.topic == JOURNAL_PREFIX + first.node
    is_step = of_journal and first.field not in ("state", "tick")
    topic = len(known_topics()) + 1 if of_journal else _topic_rank(first.topic)
    tick = _LAST if first.tick is None else first.tick
    return is_step, tick, ranks.get(first.node, len(ranks)), topic, first.topic, first.sequence


def first_field(a: bytes, b: bytes) -> tuple[str, Any, Any] | None:
    """Return path, value in ``a`` and value in ``b`` of the first field in which two payloads differ, or None."""
    if a == b:
        return None
    try:
        found = _first_value("", read_json(a, object), read_json(b, object))
    except msgspec.DecodeError:
        found = None
    if found is None:
        return ("payload", *_excerpts(a.decode(errors="replace"), b.decode(errors="replace")))
    path, left, right = found
    if isinstance(left, str) and isinstance(right, str):
        return (path, *_excerpts(left, right))
    return (path, _summary(left), _summary(right))


def _differ(a: Leaf | None, b: Leaf | None) -> bool:
    return a is None or b is None or (a.tick, a.stamp_ns, a.digest) != (b.tick, b.stamp_ns, b.digest)


def _node_ranks(a: Recording, b: Recording) -> dict[str, int]:
    """Return the rank of each node in a tick; the log comes first."""
    nodes = (LOG_NODE, *(a.header.writes or b.header.writes or NODES))
    return {node: rank for rank, node in enumerate(nodes)}


def _order(ranks: Mapping[str, int], key: Key, a: Leaf | None, b: Leaf | None) -> _Order:
    present = [leaf for leaf in (a, b) if leaf is not None]
    tick = min((leaf.tick for leaf in present if leaf.tick >= 0), default=_LAST)
    # Without a journal there are no ticks; the stamps then give the order.
    stamp = min(leaf.stamp_ns for leaf in present) if tick == _LAST else 0
    return (
        tick,
        stamp,
        ranks.get(key.node, len(ranks)),
        key.node,
        _topic_rank(key.topic),
        key.topic,
        key.start,
        key.sequence,
    )


def _topic_rank(topic: str) -> int:
    return _topic_ranks().get(topic, len(known_topics()))


@cache
def _topic_ranks() -> Mapping[str, int]:
    return {topic: rank for rank, topic in enumerate(known_topics())}


def _state_order(
    ranks: Mapping[str, int], key: StateKey, a: tuple[int, str] | None, b: tuple[int, str] | None
) -> _Order:
    tick = min(state[0] for state in (a, b) if state is not None)
    behind = len(known_topics()) + 1  # the node's messages
    return (tick, 0, ranks.get(key.node, len(ranks)), key.node, behind, "", key.start, key.number)


def _message_difference(key: Key, a: Leaf | None, b: Leaf | None) -> FirstDifference:
    left: Any
    right: Any
    if a is None or b is None:
        field, left, right = "message", _presence(a), _presence(b)
    elif a.tick != b.tick:
        field, left, right = "tick", _tick(a), _tick(b)
    elif a.stamp_ns != b.stamp_ns:
        field, left, right = "stamp_ns", a.stamp_ns, b.stamp_ns
    else:
        found = first_field(a.record.payload, b.record.payload)
        assert found is not None, "payloads with different digests are equal"
        field, left, right = found
    ticks = [leaf.tick for leaf in (a, b) if leaf is not None and leaf.tick >= 0]
    return FirstDifference(
        node=key.node,
        topic=key.topic,
        tick=min(ticks, default=None),
        sequence=key.sequence,
        field=field,
        a=left,
        b=right,
    )


def _state_difference(key: StateKey, a: tuple[int, str] | None, b: tuple[int, str] | None) -> FirstDifference:
    field = "state" if a is None or b is None or a[1] != b[1] else "tick"
    left, right = ((None if side is None else side[field == "state"]) for side in (a, b))
    return FirstDifference(
        node=key.node,
        topic=JOURNAL_PREFIX + key.node,
        tick=min(state[0] for state in (a, b) if state is not None),
        sequence=key.number,
        field=field,
        a=left,
        b=right,
    )


def _step_difference(
    ranks: Mapping[str, int], left: Mapping[StepKey, StepLine], right: Mapping[StepKey, StepLine]
) -> FirstDifference | None:
    """Return the first step that consumed or produced other messages, or the same in another order."""
    pairs = {key: (left.get(key), right.get(key)) for key in {**left, **right} if left.get(key) != right.get(key)}
    if not pairs:
        return None

    def order(key: StepKey) -> tuple[Any, ...]:
        return min(step.tick for step in pairs[key] if step is not None), ranks.get(key.node, len(ranks)), key

    key = min(pairs, key=order)
    before, after = pairs[key]
    if before is None or after is None:
        field, a_value, b_value = "step", _presence(before), _presence(after)
    else:
        field, a_value, b_value = next(_step_fields(before, after))
    return FirstDifference(
        node=key.node,
        topic=JOURNAL_PREFIX + key.node,
        tick=order(key)[0],
        sequence=key.number,
        field=field,
        a=a_value,
        b=b_value,
    )


def _step_fields(a: StepLine, b: StepLine) -> Iterator[tuple[str, Any, Any]]:
    """Yield the fields in which two steps differ, each with both values; messages as text."""
    for name in ("consumed", "produced"):
        pairs = zip_longest(getattr(a, name), getattr(b, name))
        for index, (before, after) in enumerate(pairs):
            if before != after:
                yield f"{name}[{index}]", _worded(before), _worded(after)
    for name in ("step", "tick", "stamp_ns", "state"):
        if getattr(a, name) != getattr(b, name):
            yield name, getattr(a, name), getattr(b, name)


def _worded(reference: tuple[Any, ...] | None) -> str | None:
    if reference is None:
        return None
    *node, topic, sequence = reference
    return f"{topic} {sequence}" + (f" of {node[0]}" if node else "")


def _counts(left: dict[Key, Leaf], right: dict[Key, Leaf], differing: list[Key]) -> dict[str, TopicCounts]:
    counts: dict[str, list[int]] = {}
    for column, keys in enumerate((left, right, differing)):
        for key in keys:
            counts.setdefault(key.topic, [0, 0, 0])[column] += 1
    order = sorted(counts, key=lambda topic: (_topic_rank(topic), topic))
    return {topic: TopicCounts(a=counts[topic][0], b=counts[topic][1], differ=counts[topic][2]) for topic in order}


def _first_value(path: str, a: Any, b: Any) -> tuple[str, Any, Any] | None:
    if isinstance(a, dict) and isinstance(b, dict):
        return _first_member(path, a, b)
    if isinstance(a, list) and isinstance(b, list):
        return _first_element(path, a, b)
    return None if type(a) is type(b) and a == b else (path or "payload", a, b)


def _first_member(path: str, a: dict[str, Any], b: dict[str, Any]) -> tuple[str, Any, Any] | None:
    for name in {**a, **b}:
        inner = f"{path}.{name}" if path else name
        if name not in a or name not in b:
            return inner, a.get(name), b.get(name)
        if found := _first_value(inner, a[name], b[name]):
            return found
    return None


def _first_element(path: str, a: list[Any], b: list[Any]) -> tuple[str, Any, Any] | None:
    for index, (left, right) in enumerate(zip(a, b, strict=False)):
        if found := _first_value(f"{path}[{index}]", left, right):
            return found
    return None if len(a) == len(b) else (f"{path}.length", len(a), len(b))


def _excerpts(a: str, b: str) -> tuple[str, str]:
    """Return both texts; long ones are cut to the neighbourhood of their first difference."""
    if max(len(a), len(b)) <= _SHOWN:
        return a, b
    parting = next((index for index, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
    start = max(0, parting - _SHOWN // 4)
    return _excerpt(a, start), _excerpt(b, start)


def _excerpt(text: str, start: int) -> str:
    before = "..." if start else ""
    after = "..." if start + _SHOWN < len(text) else ""
    return before + text[start : start + _SHOWN] + after


def _summary(value: Any) -> Any:
    if isinstance(value, dict | list):
        return _excerpt(msgspec.json.encode(value).decode(), 0)
    return _excerpt(value, 0) if isinstance(value, str) else value


def _presence(side: Leaf | StepLine | None) -> str:
    return "missing" if side is None else "present"


def _tick(leaf: Leaf) -> int | None:
    return leaf.tick if leaf.tick >= 0 else None
