"""Quantities of a run, tick by tick: errors of the estimates, time, and the fields of messages."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.messages import Estimate, Message, RobotState
from dynpf_runtime.node import Received
from dynpf_runtime.plan import Plan
from dynpf_services.scenario.problems import nearest

from dynpf.portable import dist
from dynpf_experiments.why.condition import Condition, Value, comparisons, holds, pointing

__all__ = ["Quantities", "Watch", "names_of", "quantities_of"]

_STATE = "/state"
_TRUTHS = ("truth/robot", "log/truth")
_NANOSECOND = 1e-9
_TOGETHER_NS = 100_000_000
"""How far apart in time an estimate and a truth are compared at most."""

_MOST_LISTED = 12

Newest = Mapping[str, Received]
"""The newest message of each topic."""


class Quantities(NamedTuple):
    """What a condition needs: its quantities by name, as functions of the newest messages, and these topics."""

    values: Mapping[str, Callable[[Newest], Value | None]]
    topics: frozenset[str]


class Watch:
    """An observer of a run that looks at the end of each tick whether a condition holds.

    ``stamp_ns`` is the logical time so far. ``failed`` is the first tick in which the condition holds, None before it;
    ``values`` are those of the last tick that was looked at, and ``extremes`` the least and the greatest number so far.
    """

    def __init__(self, condition: Condition, quantities: Quantities) -> None:
        self._condition, self._quantities = condition, quantities
        self.newest: dict[str, Received] = {}
        self.stamp_ns = 0
        self.failed: int | None = None
        self.values: dict[str, Value] = {}
        self.extremes: dict[str, tuple[float, float]] = {}

    def __call__(self, received: Received) -> None:
        """Take a message of the run."""
        self.stamp_ns = max(self.stamp_ns, received.stamp_ns)
        if received.topic in self._quantities.topics:
            self.newest[received.topic] = received

    def look(self, tick: int) -> bool:
        """Return whether the condition holds at the end of a tick, or has held before."""
        if self.failed is not None:
            return True
        found = {name: of(self.newest) for name, of in self._quantities.values.items()}
        known: dict[str, Value] = {name: value for name, value in found.items() if value is not None}
        self.values = {**known, "tick": float(tick), "time": self.stamp_ns * _NANOSECOND}
        for name, value in known.items():
            if not isinstance(value, str):
                least, most = self.extremes.get(name, (value, value))
                self.extremes[name] = min(least, value), max(most, value)
        if holds(self._condition, self.values):
            self.failed = tick
        return self.failed is not None


def quantities_of(condition: Condition, text: str, plan: Plan) -> Quantities:
    """Return the quantities of a condition on runs of a plan.

    Raises UsageError that points at a name in ``text`` that stands for none, or for one of another type.
    """
    values: dict[str, Callable[[Newest], Value | None]] = {}
    topics: set[str] = set()
    for comparison in comparisons(condition):
        found = _errors(plan).get(comparison.name)
        kinds: frozenset[type] = frozenset({float})
        if found is None and comparison.name not in {"tick", "time"}:
            of, needs, kinds = _field(comparison.name, comparison.at, text, plan)
            found = of, needs
        if found is not None:
            values[comparison.name] = found[0]
            topics.update(found[1])
        expected = type(comparison.value)
        if expected not in kinds:
            words = {float: "a number", bool: "true or false", str: "a word in quotes"}
            problem = f"is compared with {words[expected]}; expected {words[min(kinds, key=str)]}"
            raise pointing(text, comparison.at, problem)
    return Quantities(values, frozenset(topics))


def names_of(plan: Plan) -> list[str]:
    """Return the names of the quantities of a plan but the fields of its messages."""
    return [*_errors(plan), "time", "tick"]


Found = tuple[Callable[[Newest], Value | None], Sequence[str]]


def _errors(plan: Plan) -> dict[str, Found]:
    """Return the errors of the estimates, of the first one also without its node's name."""
    rows = plan.graph.topics
    found: dict[str, Found] = {}
    for topic in (name for name, row in rows.items() if row.type is Estimate and name.endswith(_STATE)):
        node = topic.removesuffix(_STATE)
        robot, slash, _ = node.rpartition("/")
        truth = next((robot + slash + name for name in _TRUTHS if robot + slash + name in rows), None)
        if truth is None:
            continue
        for name, error in (("position_error", _position_error), ("heading_error", _heading_error)):
            of = _between(topic, truth, error)
            found.setdefault(name, (of, (topic, truth)))
            found[f"{node}.{name}"] = of, (topic, truth)
    return found


def _between(
    estimate: str, truth: str, error: Callable[[Estimate, RobotState], float | None]
) -> Callable[[Newest], Value | None]:
    def of(newest: Newest) -> Value | None:
        """Return the error of the newest estimate against the newest truth."""
        estimated, true = newest.get(estimate), newest.get(truth)
        if estimated is None or true is None or abs(estimated.stamp_ns - true.stamp_ns) > _TOGETHER_NS:
            return None
        assert isinstance(estimated.message, Estimate)
        assert isinstance(true.message, RobotState)
        return error(estimated.message, true.message)

    return of


def _position_error(estimate: Estimate, truth: RobotState) -> float:
    """Return the distance between estimate and truth, m."""
    return float(dist((estimate.x, estimate.y), (truth.x, truth.y)))


def _heading_error(estimate: Estimate, truth: RobotState) -> float | None:
    """Return the angle between estimate and truth, rad, None where the truth's is not valid."""
    return abs(math.remainder(estimate.theta - truth.theta, math.tau)) if truth.heading_valid else None


def _field(
    name: str, at: int, text: str, plan: Plan
) -> tuple[Callable[[Newest], Value | None], tuple[str], frozenset[type]]:
    """Return the field of a topic's messages, its topic, and its types."""
    topic, _, path = name.partition(".")
    row = plan.graph.topics.get(topic)
    if row is None or not path:
        known = [*names_of(plan), *plan.graph.topics]
        listed = ", ".join(names_of(plan)[:_MOST_LISTED])
        problem = "no field of it is named" if row is not None else f"no such quantity{nearest(name, known)}"
        raise pointing(
            text,
            at,
            f"{problem}\n  Quantities: {listed}, and fields of topics, such as truth/robot.x (docs/topics.md)",
        )
    steps = path.split(".")
    kinds: list[msgspec.inspect.Type] = [msgspec.inspect.type_info(row.type)]
    for index, step in enumerate(steps):
        inner = [each for kind in kinds for each in _inner(kind, step)]
        if not inner:
            fields = sorted({field for kind in kinds for field in _fields(kind)})
            where = ".".join([topic, *steps[:index]])
            choice = f"It has {', '.join(fields)}." if fields else "It has no fields."
            raise pointing(text, at, f"{where} has no {step}{nearest(step, fields)}\n  {choice}")
        kinds = inner
    values = frozenset(value for kind in kinds for value in _values(kind))
    if not values:
        raise pointing(
            text, at, "is neither number, word, true nor false; name a field of it, or an item by its number"
        )
    return lambda newest: _read(newest[topic].message if topic in newest else None, steps), (topic,), values


def _alternatives(kind: msgspec.inspect.Type) -> list[msgspec.inspect.Type]:
    match kind:
        case msgspec.inspect.UnionType(types=types):
            return [each for one in types for each in _alternatives(one)]
        case msgspec.inspect.Metadata(type=inner):
            return _alternatives(inner)
    return [kind]


def _inner(kind: msgspec.inspect.Type, step: str) -> list[msgspec.inspect.Type]:
    found: list[msgspec.inspect.Type] = []
    for each in _alternatives(kind):
        match each:
            case msgspec.inspect.StructType(fields=fields):
                found += [alternative for f in fields if f.name == step for alternative in _alternatives(f.type)]
            case msgspec.inspect.VarTupleType(item_type=item) if step.isdecimal():
                found += _alternatives(item)
            case msgspec.inspect.TupleType(item_types=items) if step.isdecimal() and int(step) < len(items):
                found += _alternatives(items[int(step)])
    return found


def _fields(kind: msgspec.inspect.Type) -> list[str]:
    structs = [each for each in _alternatives(kind) if isinstance(each, msgspec.inspect.StructType)]
    return [field.name for each in structs for field in each.fields]


def _values(kind: msgspec.inspect.Type) -> Iterable[type]:
    match kind:
        case msgspec.inspect.IntType() | msgspec.inspect.FloatType():
            yield float
        case msgspec.inspect.BoolType():
            yield bool
        case msgspec.inspect.StrType() | msgspec.inspect.LiteralType():
            yield str


def _read(value: Message | None, steps: Sequence[str]) -> Value | None:
    """Return a field of a message, None where it has no value."""
    found: Any = value
    for step in steps:
        if isinstance(found, tuple):
            found = found[int(step)] if int(step) < len(found) else None
        else:
            found = getattr(found, step, None)
    if isinstance(found, bool | str):
        return found
    return float(found) if isinstance(found, int | float) else None
