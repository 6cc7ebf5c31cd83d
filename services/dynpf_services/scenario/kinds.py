"""The registry of node kinds and shared tables, by the names that scenarios use.

Each system lists its own by import strings: no part of a system is loaded before a scenario names it, and this module
knows none of them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from dynpf_formats.shipped import listed, load
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import Topic

from dynpf.types import FloatArray

if TYPE_CHECKING:
    from dynpf_services.scenario.context import Context
    from dynpf_services.scenario.schema import Scenario
    from dynpf_services.sensors.kind import SensorKind

__all__ = [
    "FactKind",
    "NodeKind",
    "Surroundings",
    "Take",
    "fact_kind",
    "fact_names",
    "node_kind",
    "node_kinds",
    "section_of",
    "sensor_kind",
    "sensor_kinds",
]

KINDS = {
    ("sensors", "simulated"): "dynpf_services.sensors.simulated:KIND",
    ("sensors", "log"): "dynpf_services.sensors.log:KIND",
}
"""The kinds of nodes that belong to no system: nodes with the sensors of all systems."""

Take = Callable[[str, str], bytes]
"""Returns a file; arguments are the path in the scenario, and the file's name relative to that path's folder."""


class NodeKind(NamedTuple):
    """A kind of node: how it is configured, which topics it reads and writes by its own names, and how it is built.

    A message type in ``reads`` stands for all topics of the same robot that carry it. ``build`` is the import string of
    a function of the configuration and the Context, loaded when a node is built. ``needs`` has the topics that must
    have a writer, each with the key in the node's table that requires it. ``problems`` yields contradictions to the
    rest of the scenario, each with its key.
    """

    config: type
    build: str
    reads: Callable[[Any, "Context"], Iterable[str | type[Message]]]
    writes: Callable[[Any, "Context"], Iterable[str] | Mapping[str, Topic]]
    needs: Callable[[Any, "Context"], Mapping[str | type[Message], str]] = lambda _config, _context: {}
    plays_log: bool = False  # whether it is the source of a run that plays an imported log
    problems: Callable[[Any, "Context"], Iterator[str]] = lambda _config, _context: iter(())


class Surroundings(NamedTuple):
    """The obstacles around a robot that a table describes, for simulated beams.

    ``walls`` returns the walls of the table, (S, 4): x1, y1, x2 and y2; ``discs`` the discs in a message of the true
    state, (D, 3): x, y and radius; metres.
    """

    walls: Callable[[Any], FloatArray]
    topic: str  # of the true state
    type: type[Message]
    discs: Callable[[Any], FloatArray]


class FactKind(NamedTuple):
    """A kind of shared table, such as a map: its type, and the files that it names.

    ``take`` reads one of ``files`` and the files that it names; it raises OSError for one that cannot be read,
    ValueError for an invalid one. ``bare`` returns the table with the bare names of its files. ``check`` runs once all
    files are read, and raises ScenarioError. ``problems`` yields contradictions to the rest of the scenario.
    """

    type: Any
    about: str  # what it is, for the reference
    files: Callable[[Any], tuple[str, ...]] = lambda _value: ()
    take: Callable[[str, Any, Take], None] = lambda _path, _value, _take: None
    bare: Callable[[Any], Any] = lambda value: value
    check: Callable[["Context"], None] = lambda _context: None
    problems: Callable[[Any, "Scenario"], Iterator[str]] = lambda _value, _scenario: iter(())
    opened: Callable[["Context"], Any] | None = None  # makes what the table describes; None: the table itself
    surroundings: Surroundings | None = None  # None: it describes none
    key: str = ""  # below the table's own, at which a file is named
    listed: bool = False  # the table is a list of files


def fact_names() -> Sequence[str]:
    """Return the keys of shared tables."""
    return [name for facts in listed("FACTS") for name in facts]


@cache
def fact_kind(name: str) -> FactKind:
    """Return the kind of the shared table with this key, which is one of ``fact_names``."""
    found: FactKind = load(next(facts[name] for facts in listed("FACTS") if name in facts))
    return found


def node_kinds(section: str | None) -> Mapping[str, str]:
    """Return the import strings of the kinds of nodes by name: those of a section, or of all without one.

    Without a section, a name that several sections have is NAME_SECTION. The only kind of a section has the name "".
    """
    found: dict[str, str] = {}
    listed = [(where, name, text) for (where, name), text in _kinds().items()]
    names = [name for _, name, _ in listed]
    for where, name, text in listed:
        if section is None:
            found[(name or where) if names.count(name) == 1 or not name else f"{name}_{where}"] = text
        elif where == section:
            found[name] = text
    return found


@cache
def node_kind(text: str) -> NodeKind:
    """Return a kind of node by its import string."""
    found: NodeKind = load(text)
    return found


def section_of(text: str) -> str:
    """Return the section to which a kind of node belongs, by its import string; "" for user nodes."""
    return next((section for (section, _), kind in _kinds().items() if kind == text), "")


@cache
def sensor_kinds() -> "tuple[SensorKind, ...]":
    """Return the sensors that the systems list."""
    return tuple(kind for sensors in listed("SENSORS") for kind in load(sensors))


def sensor_kind(name: str) -> "SensorKind":
    """Return a sensor by its name."""
    return next(kind for kind in sensor_kinds() if kind.name == name)


@cache
def _kinds() -> Mapping[tuple[str, str], str]:
    return {**KINDS, **{key: text for kinds in listed("KINDS") for key, text in kinds.items()}}
