"""A scenario: the description of a whole run, read from a TOML file and checked.

Processes of a run compare the resolved scenario, defaults and seed included, and recordings hold it.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from dynpf_formats.user_classes import UserClass
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.topics import NODES
from dynpf_runtime.faults import Fault
from msgspec import Meta

from dynpf.types import Count, Positive
from dynpf_services.scenario.kinds import fact_kind, fact_names, node_kinds
from dynpf_services.scenario.problems import unfolded
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["File", "LogFacts", "RunTable", "Scenario", "key_of", "resolved_json", "whole_json"]


class File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A file that a scenario names. A recording has its content as an attachment."""

    sha256: str
    data: bytes = b""


class RunTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of a scenario that concern the run; its other keys are tables of nodes, and tables that they share."""

    title: str
    seed: Annotated[int, Meta(ge=0, le=2**62)] = 1
    clock: Literal["lockstep", "realtime"] = "lockstep"
    # Speed of the run on the bus: logical time over wall-clock time; absent: as fast as possible in lockstep, else 1.
    # In lockstep the results do not depend on it.
    rate: Positive | None = None
    tick_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.05  # the source's period
    max_ticks: Count = 1_000_000  # the run ends here at the latest
    needs_log: bool = False  # whether the sensors play an imported log
    log_digest: str = ""  # content digest of that log, filled in when it is given
    state_digest_ticks: Count = 10  # steps between two digests of a node's state
    files: dict[str, File] = {}  # the files that it names, with their SHA-256, filled in when they are read
    # Modules of your own that it names, with a SHA-256 of their source: filled in, whatever a file says here. Other
    # modules are not imported.
    user_code: dict[str, str] = {}
    faults: tuple[Fault, ...] = ()


class Scenario(RunTable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole run: the run's keys, the shared tables by key, and each node's configuration by name."""

    facts: dict[str, Any] = {}
    nodes: dict[str, Any] = {}  # in the declared order; the graph has them in tick order
    kinds: dict[str, str] = {}  # node -> import string of its kind
    remaps: dict[str, dict[str, str]] = {}  # node -> its own name for a topic -> the topic

    def __getattr__(self, name: str) -> Any:
        """Return the configuration of a node, or a shared table, by its name; None if the run has none."""
        if name in NODES or name in self.nodes:
            return self.nodes.get(name)
        if name in fact_names():
            return self.facts.get(name)
        raise AttributeError(f"a scenario has no {name!r}")

    def changed(self, **tables: Any) -> "Scenario":
        """Return the scenario with other values of the run's keys, of shared tables, and of nodes.

        A node keeps its kind; None removes it from the run. Raises TypeError for an unknown key.
        """
        own = {name: value for name, value in tables.items() if name in RunTable.__struct_fields__}
        nodes = {**self.nodes, **{name: value for name, value in tables.items() if name in self.nodes}}
        facts = {name: value for name, value in tables.items() if name in fact_names()}
        if unknown := tables.keys() - own.keys() - nodes.keys() - facts.keys():
            raise TypeError(f"a scenario has no {', '.join(sorted(unknown))}")
        return msgspec.structs.replace(
            self,
            nodes={name: config for name, config in nodes.items() if config is not None},
            facts={**self.facts, **facts},
            **own,
        )

    @property
    def user_classes(self) -> tuple[UserClass, ...]:
        """The user classes that it names, each with its key."""
        found = []
        for node, config in self.nodes.items():
            for key, name in named_classes(config, key_of(node)):
                module, _, bare = name.partition(":")
                found.append(UserClass(key, module, bare))
        return tuple(found)

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths of the files that it names."""
        return tuple(path for key, value in self.facts.items() for path in fact_kind(key).files(value))

    @property
    def tick_ns(self) -> int:
        """The source's period, ns."""
        return round(self.tick_s * 1e9)

    def file(self, path: str, key: str) -> bytes:
        """Return the content of a file that it names; raises ScenarioError naming ``key`` if it was not read."""
        file = self.files.get(PurePosixPath(path).name)
        if file is None or not file.data:
            raise ScenarioError(f"{key}: the content of {path} did not come along with the scenario")
        return file.data


class LogFacts(NamedTuple):
    """Facts of an imported log that a scenario takes over.

    Its content digest, its landmarks, the reference pose at its start by the robot's name ("" if there is only one),
    the files of its map by name, and the topics of its records where they are known.
    """

    digest: str
    landmarks: Sequence[Mapping[str, Any]]
    starts: Mapping[str, tuple[float, float, float]] = {}
    files: Mapping[str, bytes] = {}
    topics: frozenset[str] | None = None

    @property
    def map(self) -> str | None:
        """The YAML file of the log's map."""
        return next((name for name in self.files if name.endswith((".yaml", ".yml"))), None)


def key_of(node: str) -> str:
    """Return the key of a node's table in a scenario."""
    return node if node in NODES else f"nodes.{node}"


def named_classes(value: Any, key: str) -> Iterable[tuple[str, str]]:
    """Yield the user classes that a table names, each with its key."""
    match value:
        case UserComponent(name=name):
            yield f"{key}.kind", name
        case msgspec.Struct():
            for field in value.__struct_fields__:
                yield from named_classes(getattr(value, field), f"{key}.{field}")
        case tuple() | list():
            for index, item in enumerate(value):
                yield from named_classes(item, f"{key}.{index}")


def resolved_json(scenario: Scenario) -> str:
    """Return the scenario with all its defaults as JSON text with sorted keys, and files by their digests alone."""
    files = {name: File(sha256=file.sha256) for name, file in scenario.files.items()}
    return whole_json(msgspec.structs.replace(scenario, files=files))


def whole_json(scenario: Scenario) -> str:
    """Return the resolved scenario as JSON with the content of its files, for another process to run it."""
    own = {field: getattr(scenario, field) for field in RunTable.__struct_fields__}
    tables = {name: _table(scenario, name) for name in scenario.nodes}
    shipped = {name: table for name, table in tables.items() if name in NODES}
    further = [{"name": name, **table} for name, table in tables.items() if name not in NODES]
    whole = {**own, **scenario.facts, **shipped, **({"nodes": further} if further else {})}
    return msgspec.json.encode(_builtin(whole), order="sorted").decode()


def _table(scenario: Scenario, name: str) -> dict[str, Any]:
    """Return a node's table in the form of a scenario file."""
    table = _builtin(scenario.nodes[name])
    kind = next((kind for kind, text in node_kinds(None).items() if text == scenario.kinds[name]), None)
    named = {} if name in NODES or kind is None else {"kind": kind}
    remap = scenario.remaps.get(name)
    return {**table, **named, **({"remap": remap} if remap else {})}


def _builtin(value: Any) -> Any:
    return unfolded(msgspec.to_builtins(value))
