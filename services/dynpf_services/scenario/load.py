"""Loads and checks a scenario from a TOML file.

Loading checks every key, type and range, and reports each problem with the file, the key, the value, what was expected,
and the nearest known name.
"""

import errno
import json
import re
import tomllib
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import dynpf_scenarios
import msgspec
from dynpf_formats.regular_files import read_regular
from dynpf_formats.user_classes import CLASS_NAME
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.keys import OBSERVER, OPERATOR, RECORDER, ROUTER, SHARED
from dynpf_protocol.topics import NODES

from dynpf.params import infinite_numbers
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.files import make_paths_absolute, with_files
from dynpf_services.scenario.kinds import fact_kind, fact_names, node_kind, node_kinds
from dynpf_services.scenario.overrides import apply_override
from dynpf_services.scenario.problems import (
    IMPORTED_LOG,
    chosen_elsewhere,
    explain,
    faulty_faults,
    folded,
    nearest,
    no_scenario,
    not_one_of,
    unknown_keys,
)
from dynpf_services.scenario.schema import LogFacts, RunTable, Scenario, key_of
from dynpf_services.scenario.user_code import source_digests

__all__ = [
    "find_scenario",
    "load_scenario",
    "override_resolved",
    "parse_scenario",
    "scenario_files",
    "with_user_code",
]

SCENARIOS = Path(dynpf_scenarios.__path__[0])

NODE_NAME = re.compile(r"[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*")
RESERVED = frozenset({ROUTER, RECORDER, OPERATOR, OBSERVER, *SHARED, "event", "journal", "truth", "camera"})
"""Names that no node may have: first parts of topics that belong to no node, and other processes."""

_LARGEST = 2**25
"""Bytes of a scenario's file."""

SENSORS = "sensors/"
"""The beginning of the topics of sensors, which play the log's records of the same name."""

ROBOT = "robot"
"""The section whose tables describe the nodes of each robot in ``robots``."""


def scenario_files() -> list[Path]:
    """Return the scenarios that come with dynpf, by name."""
    return sorted(SCENARIOS.glob("*.toml"))


def find_scenario(name: str) -> Path:
    """Return the file of a scenario given by name or path; raises ScenarioError with the nearest name."""
    path = Path(name)
    if path.suffix in {".toml", ".json"} or (path.parent != Path() and not path.exists()):
        if not path.is_file():
            raise ScenarioError(f"scenario file {name}: no such file")
        return path
    known = {file.stem: file for file in scenario_files()}
    if name not in known:
        unknown = f"unknown scenario {name!r}{nearest(name, list(known))} (dynpf list shows them)"
        raise ScenarioError(f"{name}: {no_scenario(path)}" if path.exists() else unknown)
    return known[name]


def load_scenario(
    name: str,
    *,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    clock: str | None = None,
    log: LogFacts | None = None,
    allow_code: Container[str] | None = None,
) -> Scenario:
    """Return the resolved scenario: the file, then the facts of the log, then ``--set`` overrides, seed and clock.

    ``allow_code`` has the user modules that may be imported; None, for a file that is believed, all that it names.
    Raises ScenarioError that lists every problem found.
    """
    path = find_scenario(name)
    raw = _raw(path)
    with _located(str(path)):
        raw = _with_tables(raw)
    log_map = log.map if log is not None and "map" not in raw else None
    if log is not None:
        _take_from_log(raw, log)
    for override in overrides:
        apply_override(raw, override)
        make_paths_absolute(raw, override)
    with _located(str(path)):
        raw = _with_robots(raw)
    if log is not None:
        for node, table in (*raw.items(), *raw.get("nodes", {}).items()):
            _set_start(table, node.rpartition("/")[0], log)
    if seed is not None:
        raw["seed"] = seed
    if clock is not None:
        raw["clock"] = clock

    def read(name: str, named: str) -> bytes:
        if log is None or named != log_map:
            return read_regular(path.parent / name)
        bare = PurePath(name).name  # the log's map and the map's image are attached to the log
        if bare not in log.files:
            raise FileNotFoundError(errno.ENOENT, "the log has no such file attached")
        return log.files[bare]

    scenario = with_user_code(parse_scenario(raw, str(path)), str(path), allow_code)
    if log is not None:
        _raise(str(path), _without_readings(scenario, log))
    return with_files(scenario, str(path), read)


def _raw(path: Path) -> dict[str, Any]:
    try:
        text = read_regular(path, _LARGEST).decode()
        raw = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise ScenarioError(f"{path}: {error}") from error
    except RecursionError:
        raise ScenarioError(f"{path}: is nested too deeply") from None
    if not isinstance(raw, dict):
        raise ScenarioError(f"{path}: holds a {type(raw).__name__}, expected a table of keys")
    return raw


def override_resolved(resolved: str, overrides: Sequence[str], where: str) -> Scenario:
    """Return the scenario of a recording with overrides applied, without the content of its files.

    Raises ScenarioError naming ``where``.
    """
    try:
        raw = json.loads(resolved)
        if not isinstance(raw, dict):
            raise ScenarioError(f"{where}: its scenario is a {type(raw).__name__}, expected a table of keys")
        if isinstance(raw.get("import"), dict):  # an importer describes its source instead of a scenario
            raise ScenarioError(f"{where}: {IMPORTED_LOG.format(where)}")
        with _located(where):
            raw = _with_tables(raw)
        for override in overrides:
            apply_override(raw, override)
        return parse_scenario(raw, where)
    except json.JSONDecodeError as error:
        raise ScenarioError(f"{where}: its scenario cannot be read: {error}") from error
    except RecursionError:
        raise ScenarioError(f"{where}: its scenario is nested too deeply") from None


def with_user_code(scenario: Scenario, where: str, modules: Container[str] | None = None) -> Scenario:
    """Return the scenario with the digests of the user modules, which are imported when its nodes are built.

    For a scenario from elsewhere, ``modules`` are those that may be imported. Raises ScenarioError for a module that
    does not exist.
    """
    named = [user for user in scenario.user_classes if modules is None or user.module in modules]
    try:
        return msgspec.structs.replace(scenario, user_code=source_digests(named))
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error


def parse_scenario(raw: Mapping[str, Any], where: str) -> Scenario:
    """Return the scenario in ``raw``; raises ScenarioError naming ``where`` and every problem.

    No file that it names is read, and no user class is imported: ``user_code`` stays empty.
    """
    with _located(where):
        layout = _layout({key: value for key, value in raw.items() if value is not None})
    info = msgspec.inspect.type_info(layout.type)
    table = folded(info, layout.raw)
    _raise(where, unknown_keys(info, table, ""))
    _raise(where, (f"{path}: {number}: expected a finite number" for path, number in infinite_numbers(table)))
    try:
        parsed = msgspec.convert(table, layout.type)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{where}: {explain(error, table)}") from error
    nodes = getattr(parsed, "nodes", None)
    scenario = Scenario(
        **{field: getattr(parsed, field) for field in RunTable.__struct_fields__ if field != "user_code"},
        facts={name: getattr(parsed, name) for name in layout.facts},
        nodes={name: getattr(parsed if name in NODES else nodes, layout.fields[name]) for name in layout.kinds},
        kinds=layout.kinds,
        remaps=layout.remaps,
    )
    _raise(where, _contradictions(scenario))
    return scenario


@contextmanager
def _located(where: str) -> Iterator[None]:
    """Prefix the lines of a ScenarioError with the file."""
    try:
        yield
    except ScenarioError as error:
        raise ScenarioError("\n".join(f"{where}: {line}" for line in str(error).splitlines())) from error


def _raise(where: str, problems: Iterator[str] | Sequence[str]) -> None:
    if lines := [f"{where}: {problem}" for problem in problems]:
        raise ScenarioError("\n".join(lines))


class _Layout(NamedTuple):
    """The struct type of one scenario, made for its nodes; ``fields`` are the attributes of the nodes in it."""

    type: type[msgspec.Struct]
    raw: dict[str, Any]
    facts: tuple[str, ...]
    fields: dict[str, str]
    kinds: dict[str, str]
    remaps: dict[str, dict[str, str]]


def _layout(raw: dict[str, Any]) -> _Layout:
    """Return the type to which ``raw`` is converted; raises ScenarioError for an invalid kind or name."""
    raw, remaps = _without_remaps(_with_robots(_with_tables(raw)))
    facts = tuple(name for name in fact_names() if name in raw)
    kinds: dict[str, str] = {}
    sections: list[Any] = []
    for name in NODES:
        if name in raw:
            kinds[name], raw[name] = _kind(name, raw[name], name)
            sections.append((name, node_kind(kinds[name]).config))
        else:
            sections.append((name, None, None))
    fields = {name: name for name in NODES}
    further: list[Any] = []
    tables = {}
    for name, table in raw.get("nodes", {}).items():
        if name in NODES or name in RESERVED or not NODE_NAME.fullmatch(name):
            expected = "lower-case letters, digits and _, from a letter on, with / after the name of a robot"
            taken = f"; {name!r} is reserved" if name in {*NODES, *RESERVED} else ""
            raise ScenarioError(f"nodes: {name!r} is no name for a node; expected {expected}{taken}")
        kinds[name], tables[name] = _kind(name, table, None)
        fields[name] = f"node_{len(further)}"
        further.append((fields[name], node_kind(kinds[name]).config))
    if further:
        names = {field: name for name, field in fields.items()}
        own = msgspec.defstruct("Nodes", further, rename=names.get, frozen=True, forbid_unknown_fields=True)
        sections.append(("nodes", own))
        raw["nodes"] = tables
    shared = [(name, fact_kind(name).type) if name in facts else (name, None, None) for name in fact_names()]
    fresh = msgspec.defstruct(
        "Scenario",
        [*shared, *sections],
        bases=(RunTable,),
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
    )
    return _Layout(fresh, raw, facts, fields, kinds, remaps)


def _kind(name: str, table: Any, section: str | None) -> tuple[str, Any]:
    """Return the import string of a node's kind, and its table in the form of the kind's configuration."""
    kinds = node_kinds(section)
    if isinstance(table, str):
        table = {"kind": table}
    kind = table.get("kind", "") if isinstance(table, dict) else ""
    if isinstance(kind, str) and ":" in kind:
        return "dynpf_services.scenario.user_nodes:KIND", table
    key = key_of(name)
    if not isinstance(table, dict):
        raise ScenarioError(f"{key}: {table!r}; expected a table, such as [{key}]")
    if not isinstance(kind, str) or kind not in kinds:
        told = not_one_of(kind or None, [*sorted(kinds), "package.module:Name"])
        others = chosen_elsewhere(str(kind), {name: node_kind(text).config for name, text in sorted(kinds.items())})
        raise ScenarioError(f"{key}.kind: {told}{'' if 'did you mean' in told else others}")
    text = kinds[kind]
    tag = node_kind(text).config.__struct_config__.tag  # type: ignore[attr-defined]
    given = {name: value for name, value in table.items() if name != "kind"}
    return text, given if tag is None else {"kind": tag, **given}


def _with_tables(raw: dict[str, Any]) -> dict[str, Any]:
    """Return ``raw`` with the tables of other nodes by name; a resolved scenario lists them to keep their order."""
    nodes = raw.get("nodes", {})
    if isinstance(nodes, dict):
        return raw
    if not isinstance(nodes, list) or not all(isinstance(table, dict) for table in nodes):
        raise ScenarioError("nodes: expected a table for each node, such as [nodes.other]")
    named = {str(table.get("name", "")): {key: table[key] for key in table if key != "name"} for table in nodes}
    return {**raw, "nodes": named}


def _with_robots(raw: dict[str, Any]) -> dict[str, Any]:
    """Return ``raw`` with the tables of [robot] replaced by a node for each robot."""
    names, tables = raw.pop("robots", None), raw.pop(ROBOT, None)
    if names is None and tables is None:
        return raw
    if not isinstance(names, list) or not all(isinstance(name, str) and NODE_NAME.fullmatch(name) for name in names):
        raise ScenarioError(f"robots: {names!r}; expected a list of names, such as ['r1', 'r2']")
    if len({*names}) < len(names):
        raise ScenarioError(f"robots: {names!r}; two robots have one name")
    if not isinstance(tables, dict) or not tables:
        raise ScenarioError("robot: missing; expected the tables of the nodes that each robot has")
    nodes = {f"{robot}/{name}": deepcopy(table) for robot in names for name, table in tables.items()}
    return {**raw, "nodes": {**raw.get("nodes", {}), **nodes}}


def _without_remaps(raw: dict[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, str]]]:
    """Return ``raw`` without the remaps in the nodes' tables, and the remaps by node."""
    remaps: dict[str, dict[str, str]] = {}

    def rest(name: str, table: Any) -> Any:
        if not isinstance(table, dict) or "remap" not in table:
            return table
        remap = table["remap"]
        if not isinstance(remap, dict) or not all(isinstance(topic, str) for topic in remap.values()):
            raise ScenarioError(f"{key_of(name)}.remap: {remap!r}; expected topics by the node's own names for them")
        remaps[name] = remap
        return {key: value for key, value in table.items() if key != "remap"}

    changed = {name: rest(name, raw[name]) for name in NODES if name in raw}
    if "nodes" in raw:
        changed["nodes"] = {name: rest(name, table) for name, table in raw["nodes"].items()}
    return {**raw, **changed}, remaps


def _take_from_log(raw: dict[str, Any], log: LogFacts) -> None:
    """Fill in map and landmarks from the log if the scenario has none."""
    raw["log_digest"] = log.digest
    if log.landmarks:
        raw.setdefault("landmarks", [dict(landmark) for landmark in log.landmarks])
    if log.map is not None:
        raw.setdefault("map", {"kind": "occupancy", "file": log.map})


def _set_start(table: Any, robot: str, log: LogFacts) -> None:
    """Fill in the start of a robot's filter from the log, if the table is that of a filter with a known start."""
    if not isinstance(table, dict) or table.get("kind") != "localization":
        return
    start, pose = table.get("start"), log.starts.get(robot)
    if pose is not None and isinstance(start, dict) and start.get("kind") == "known":
        for key, value in zip(("x", "y", "theta"), pose, strict=True):
            start.setdefault(key, value)


def _without_readings(scenario: Scenario, log: LogFacts) -> Iterator[str]:
    """Yield a problem for each node of which the log has none of the readings; those of a user's classes are his."""
    if log.topics is None or scenario.user_classes:
        return
    for name, config in scenario.nodes.items():
        robot, slash, _ = name.rpartition("/")
        kind = node_kind(scenario.kinds[name])
        needs = kind.needs(config, Context(scenario, name))
        own = {topic: key for topic, key in needs.items() if isinstance(topic, str) and topic.startswith(SENSORS)}
        records = sorted(f"{robot}{slash}log/{topic.removeprefix(SENSORS)}" for topic in own)
        if records and not scenario.remaps.get(name) and log.topics.isdisjoint(records):
            there = ", ".join(sorted(log.topics))
            yield (
                f"{key_of(name)}.{next(iter(own.values()))}: takes {' or '.join(records)}, of which the log has none; "
                f"it has {there}: take a scenario for these (dynpf localize chooses one)"
            )


def _contradictions(scenario: Scenario) -> Iterator[str]:
    players = [name for name, text in scenario.kinds.items() if node_kind(text).plays_log]
    if not players and not any(name.rpartition("/")[2] == "simulator" for name in scenario.nodes):
        yield "a run needs a source: a [simulator], or [sensors] that play a log"
    if scenario.needs_log and "simulator" in scenario.nodes:
        yield "simulator: a run that plays a log (needs_log) has no simulator"
    if bool(players) != scenario.needs_log:
        yield "sensors.kind: 'log' and needs_log = true go together"
    yield from faulty_faults(scenario)
    for name, config in scenario.nodes.items():
        yield from node_kind(scenario.kinds[name]).problems(config, Context(scenario, name))
    for key, value in scenario.facts.items():
        yield from fact_kind(key).problems(value, scenario)
    for user in scenario.user_classes:
        if not CLASS_NAME.fullmatch(user.text):
            yield f"{user.key}: {user.text!r}; expected package.module:Name"
