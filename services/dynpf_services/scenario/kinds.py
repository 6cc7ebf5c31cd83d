"""Kinds of nodes, and tables that nodes share: what a scenario may hold, by the names that it uses for them.

Each system of nodes lists its own in a module of its own, by import strings: nothing of a system is loaded before a
scenario names it, and nothing here knows one.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from dynpf_formats.shipped import listed, load
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import Topic

from dynpf.se2 import FloatArray

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
"""The kinds of nodes that belong to no system: they have the sensors of all."""

Take = Callable[[str, str], bytes]
"""Gives a file: called with the path that the scenario names, and with the file's name seen from that path's folder."""


class NodeKind(NamedTuple):
    """A kind of node: how it is configured, which topics it reads and writes by its own names, and how it is built.

    Of a type of messages, it reads all topics of the same robot that carry it. ``build`` is the import string of a
    function of the configuration and the Context, loaded when a node is built.
    ``needs`` are those topics of which one without a writer is an error, each with the key below the node's that asks
    for it. ``problems`` yields what contradicts the rest of the scenario, each with its key.
    """

    config: type
    build: str
    reads: Callable[[Any, "Context"], Iterable[str | type[Message]]]
    writes: Callable[[Any, "Context"], Iterable[str] | Mapping[str, Topic]]
    needs: Callable[[Any, "Context"], Mapping[str | type[Message], str]] = lambda _config, _context: {}
    plays_log: bool = False  # it is the source of a run that plays an imported log
    problems: Callable[[Any, "Context"], Iterator[str]] = lambda _config, _context: iter(())


class Surroundings(NamedTuple):
    """What a table says of the world that a robot is in, as far as a sensor's beams meet it.

    ``walls`` returns those of the table, (S, 4), x1, y1, x2 and y2; ``discs`` what stands about by a message of the
    true state, (D, 3), x, y and radius; metres.
    """

    walls: Callable[[Any], FloatArray]
    topic: str  # of the true state
    type: type[Message]
    discs: Callable[[Any], FloatArray]


class FactKind(NamedTuple):
    """A table that nodes share, such as a map: its type, and the files that it names.

    ``take`` takes one of ``files`` and whatever it names; it raises OSError for one that cannot be read, ValueError for
    one that is not what it should be. ``bare`` returns the table with the bare names of its files. ``check`` raises
    ScenarioError once all files are there, ``problems`` yields what contradicts the rest of the scenario.
    """

    type: Any
    about: str  # what it is, for the reference
    files: Callable[[Any], tuple[str, ...]] = lambda _value: ()
    take: Callable[[str, Any, Take], None] = lambda _path, _value, _take: None
    bare: Callable[[Any], Any] = lambda value: value
    check: Callable[["Context"], None] = lambda _context: None
    problems: Callable[[Any, "Scenario"], Iterator[str]] = lambda _value, _scenario: iter(())
    opened: Callable[["Context"], Any] | None = None  # what it stands for; absent: itself
    surroundings: Surroundings | None = None  # absent: it tells of none
    key: str = ""  # below the table's own, at which a file is named
    listed: bool = False  # the table is a list of files


def fact_names() -> Sequence[str]:
    """Return the keys of the tables that nodes share."""
    return [name for facts in listed("FACTS") for name in facts]


@cache
def fact_kind(name: str) -> FactKind:
    """Return what a shared table is, by its key; raises KeyError."""
    found: FactKind = load(next(facts[name] for facts in listed("FACTS") if name in facts))
    return found


def node_kinds(section: str | None) -> Mapping[str, str]:
    """Return the import strings of the kinds of nodes by name: those of a section, without one those of all.

    A name that several sections have is called NAME_SECTION outside of them. A section with one kind alone has it
    under the name "".
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
    """Return the section to which a kind of node belongs, by its import string; "" for a kind of the user's."""
    return next((section for (section, _), known in _kinds().items() if known == text), "")


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
