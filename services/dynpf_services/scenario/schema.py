"""Scenarios: one TOML file describes a whole run.

Loading checks every key, type and range at once and says what is wrong in words: the file, the key, the value, what was
expected, and the nearest known name. The resolved scenario, defaults and seed included, is what processes compare when
they meet and what a recording carries.
"""

import difflib
import errno
import hashlib
import json
import re
import tomllib
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, NamedTuple

import dynpf_scenarios
import msgspec
from dynpf_formats.user_classes import CLASS_NAME, UserClass
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.topics import NODES, TOPICS
from dynpf_runtime.faults import Fault
from msgspec import Meta

from dynpf_services.colon import MOST_DRAWINGS, ColonConfig, ColonWorld
from dynpf_services.controller.config import RearrangementControllerConfig, WaypointsConfig
from dynpf_services.estimator.config import (
    CapsuleEstimatorConfig,
    LocalizationConfig,
    RearrangementConfig,
    UserComponent,
)
from dynpf_services.maps import BitmapConfig, OccupancyConfig, SegmentsConfig, open_maps
from dynpf_services.scenario.user_code import source_digests
from dynpf_services.sensors.config import CapsuleSensorsConfig, LogSensorsConfig, SimulatedSensorsConfig
from dynpf_services.simulator.config import CapsuleConfig, RoomConfig, WorkspaceConfig
from dynpf_services.task import RearrangementTask
from dynpf_services.vision.config import VisionConfig

__all__ = [
    "File",
    "LogFacts",
    "Scenario",
    "colon_world",
    "find_scenario",
    "load_scenario",
    "override_resolved",
    "parse_scenario",
    "resolved_json",
    "scenario_files",
    "whole_json",
    "with_files",
    "with_user_code",
]

SCENARIOS = Path(dynpf_scenarios.__path__[0])


class File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A file that a scenario names: what is in it. A recording carries the content as an attachment."""

    sha256: str
    data: bytes = b""


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole run. The nodes that take part are those whose section is present."""

    title: str
    seed: Annotated[int, Meta(ge=0, le=2**62)] = 1
    clock: Literal["lockstep", "realtime"] = "lockstep"
    # How many times as fast as its own time the run goes on the bus; absent: in lockstep as fast as it can, else once.
    # In lockstep the results are the same whatever it is.
    rate: Annotated[float, Meta(gt=0.0)] | None = None
    tick_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.05  # the source's period
    max_ticks: Annotated[int, Meta(ge=1)] = 1_000_000  # the run ends here though nobody has finished it
    needs_log: bool = False  # the sensors process plays an imported log
    log_digest: str = ""  # content digest of that log, filled in when it is given
    state_digest_ticks: Annotated[int, Meta(ge=1)] = 10  # a digest of each node's state every so many steps
    files: dict[str, File] = {}  # the files that it names, with their SHA-256, filled in when they are read
    # Modules of your own that it names, with a SHA-256 of their source: filled in, whatever a file says here. What is
    # not in it is not imported.
    user_code: dict[str, str] = {}
    task: RearrangementTask | None = None
    map: OccupancyConfig | BitmapConfig | SegmentsConfig | None = None
    landmarks: tuple[Landmark, ...] = ()
    colon: ColonConfig | None = None
    # Bitmaps (PNG, BMP, PGM) that take the place of the tube of [colon]: a, b and so on by their order. Paths are seen
    # from the scenario's folder, on the command line from the current one; a recording carries the content.
    maps: Annotated[tuple[str, ...], Meta(max_length=MOST_DRAWINGS)] = ()
    simulator: WorkspaceConfig | RoomConfig | CapsuleConfig | None = None
    vision: VisionConfig | None = None
    sensors: SimulatedSensorsConfig | LogSensorsConfig | CapsuleSensorsConfig | None = None
    estimator: RearrangementConfig | LocalizationConfig | CapsuleEstimatorConfig | None = None
    controller: RearrangementControllerConfig | WaypointsConfig | None = None
    faults: tuple[Fault, ...] = ()

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes that take part, in tick order; the first is the source."""
        return tuple(name for name in NODES if getattr(self, name) is not None)

    @property
    def user_classes(self) -> tuple[UserClass, ...]:
        """The user's classes that it names, by key."""
        if not isinstance(self.estimator, LocalizationConfig):
            return ()
        parted = ((key, *name.partition(":")) for key, name in self.estimator.user_classes)
        return tuple(UserClass(key, module, name) for key, module, _, name in parted)

    @property
    def paths(self) -> tuple[str, ...]:
        """The files that it names, as it names them."""
        chosen = (self.map.file,) if isinstance(self.map, OccupancyConfig | BitmapConfig) else ()
        return (*chosen, *self.maps)

    @property
    def tick_ns(self) -> int:
        return round(self.tick_s * 1e9)


class LogFacts(NamedTuple):
    """What an imported log brings to a scenario.

    Its content digest, its landmarks, the reference pose at its start, the files of its map by their names, and the
    range that a beam without return reads.
    """

    digest: str
    landmarks: Sequence[Mapping[str, Any]]
    start: tuple[float, float, float] | None
    files: Mapping[str, bytes] = {}
    range_max: float | None = None

    @property
    def map(self) -> str | None:
        """The YAML file of the log's map."""
        return next((name for name in self.files if name.endswith((".yaml", ".yml"))), None)


def scenario_files() -> list[Path]:
    """Return the scenarios that come with dynpf, by name."""
    return sorted(SCENARIOS.glob("*.toml"))


def find_scenario(name: str) -> Path:
    """Return the file of a scenario given by name or path; raises ScenarioError with the nearest name."""
    path = Path(name)
    if path.suffix in {".toml", ".json"} or path.parent != Path():
        if not path.is_file():
            raise ScenarioError(f"scenario file {name}: no such file")
        return path
    known = {file.stem: file for file in scenario_files()}
    if name not in known:
        raise ScenarioError(f"unknown scenario {name!r}{_nearest(name, list(known))} (dynpf list shows them)")
    return known[name]


def load_scenario(
    name: str,
    *,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    clock: str | None = None,
    log: LogFacts | None = None,
) -> Scenario:
    """Return the resolved scenario: the file, then what the log brings, then ``--set`` overrides, seed and clock.

    Raises ScenarioError that lists every problem found.
    """
    path = find_scenario(name)
    try:
        text = path.read_text(encoding="utf-8")
        raw = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise ScenarioError(f"{path}: {error}") from error
    if not isinstance(raw, dict):
        raise ScenarioError(f"{path}: holds a {type(raw).__name__}, expected a table of keys")
    brought = log.map if log is not None and "map" not in raw else None
    if log is not None:
        _take_from_log(raw, log)
    for override in overrides:
        _apply(raw, override)
        _seen_from_here(raw, override)
    if seed is not None:
        raw["seed"] = seed
    if clock is not None:
        raw["clock"] = clock

    def read(name: str, named: str) -> bytes:
        if log is None or named != brought:
            return (path.parent / name).read_bytes()
        bare = PurePath(name).name  # the log's map, and the image that it names, are what came along with the log
        if bare not in log.files:
            raise FileNotFoundError(errno.ENOENT, "the log has no such file attached")
        return log.files[bare]

    scenario = with_user_code(parse_scenario(raw, str(path)), str(path))
    return with_files(scenario, str(path), read)


def parse_scenario(raw: Mapping[str, Any], where: str) -> Scenario:
    """Return the scenario in ``raw``; raises ScenarioError naming ``where`` and every problem.

    No file that it names is read, and no class of the user's looked for: ``user_code`` stays empty.
    """
    info = msgspec.inspect.type_info(Scenario)
    raw = _folded(info, raw)
    problems = list(_unknown_keys(info, raw, ""))
    if problems:
        raise ScenarioError("\n".join(f"{where}: {problem}" for problem in problems))
    try:
        scenario = msgspec.convert(raw, Scenario)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{where}: {_explain(error, raw)}") from error
    problems = list(_contradictions(scenario))
    if problems:
        raise ScenarioError("\n".join(f"{where}: {problem}" for problem in problems))
    return msgspec.structs.replace(scenario, user_code={})


def with_user_code(scenario: Scenario, where: str, modules: Container[str] | None = None) -> Scenario:
    """Return the scenario with the digests of the user's modules, which are imported when its nodes are built.

    Of a scenario that somebody else has written, those among ``modules`` alone. Raises ScenarioError for a module that
    is not there.
    """
    named = [one for one in scenario.user_classes if modules is None or one.module in modules]
    try:
        return msgspec.structs.replace(scenario, user_code=source_digests(named))
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error


def with_files(scenario: Scenario, where: str, read: Callable[[str, str], bytes]) -> Scenario:
    """Return the scenario with the files that it names in it.

    ``read`` gives a file by its path; it is told, too, which of ``scenario.paths`` led to it, for a map names its
    image. In the result files go by their bare names, so that the same files in another folder make the same scenario;
    by its bare name, a file is taken from the scenario if that holds it.
    Raises ScenarioError for a file that cannot be read or is no map.
    """
    held = {name: file.data for name, file in scenario.files.items() if file.data}
    found: dict[str, bytes] = {}

    def take(named: str, name: str) -> bytes:
        folder, bare = PurePath(named).parent, PurePath(name).name
        data = held[bare] if bare in held and folder == PurePath() else read(str(folder / name), named)
        if found.setdefault(bare, data) != data:
            raise ValueError(f"two files are called {bare}")
        return data

    chosen = _take_map(scenario, where, take)
    drawings = _take_drawings(scenario, where, take)
    scenario = msgspec.structs.replace(
        scenario,
        map=chosen,
        maps=drawings,
        files={name: File(sha256=hashlib.sha256(data).hexdigest(), data=data) for name, data in found.items()},
    )
    if drawings and (world := colon_world(scenario)) is not None:
        try:
            world.drawn()
        except ScenarioError as error:
            raise ScenarioError(f"{where}: {error}") from error
    return scenario


def _take_map(
    scenario: Scenario, where: str, take: Callable[[str, str], bytes]
) -> OccupancyConfig | BitmapConfig | SegmentsConfig | None:
    """Take the files of the map, if it has any, and return it with the bare name of the one that it names."""
    config = scenario.map
    if not isinstance(config, OccupancyConfig | BitmapConfig):
        return config
    try:
        open_maps(config, None, lambda name: take(config.file, name))
    except OSError as error:
        raise ScenarioError(f"{where}: map.file: {config.file!r} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ScenarioError(f"{where}: map.file: {error}") from error
    return msgspec.structs.replace(config, file=PurePath(config.file).name)


def _take_drawings(scenario: Scenario, where: str, take: Callable[[str, str], bytes]) -> tuple[str, ...]:
    """Take the bitmaps of the tube and return their bare names."""
    for path in scenario.maps:
        try:
            take(path, PurePath(path).name)
        except OSError as error:
            raise ScenarioError(f"{where}: maps: {path!r} cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise ScenarioError(f"{where}: maps: {error}") from error
    return tuple(PurePath(path).name for path in scenario.maps)


def colon_world(scenario: Scenario) -> ColonWorld | None:
    """Return the tube of a run with its maps and route, None for a run without; raises ScenarioError."""
    if scenario.colon is None:
        return None
    lacking = [name for name in scenario.maps if name not in scenario.files or not scenario.files[name].data]
    if lacking:
        raise ScenarioError(f"maps: the content of {lacking[0]} did not come along with the scenario")
    return ColonWorld(scenario.colon, [(name, scenario.files[name].data) for name in scenario.maps])


def resolved_json(scenario: Scenario) -> str:
    """Return the scenario with all its defaults as JSON text with sorted keys; of files, the digests alone."""
    files = {name: File(sha256=file.sha256) for name, file in scenario.files.items()}
    return whole_json(msgspec.structs.replace(scenario, files=files))


def whole_json(scenario: Scenario) -> str:
    """Return the resolved scenario with the content of its files: what another process needs to run it."""
    return msgspec.json.encode(_unfolded(msgspec.to_builtins(scenario)), order="sorted").decode()


def _take_from_log(raw: dict[str, Any], log: LogFacts) -> None:
    """Fill in what the scenario leaves to the log: the map, and where a known start is."""
    raw["log_digest"] = log.digest
    if log.landmarks:
        raw.setdefault("landmarks", [dict(landmark) for landmark in log.landmarks])
    if log.map is not None:
        raw.setdefault("map", {"kind": "occupancy", "file": log.map})
    estimator = raw.get("estimator")
    if log.range_max is not None and isinstance(estimator, dict) and estimator.get("kind") == "localization":
        estimator.setdefault("scan_range_max", log.range_max)
    start = estimator.get("start") if isinstance(estimator, dict) else None
    if log.start is not None and isinstance(start, dict) and start.get("kind") == "known":
        for key, value in zip(("x", "y", "theta"), log.start, strict=True):
            start.setdefault(key, value)


def _folded(info: Any, value: Any) -> Any:
    """Return ``value`` as msgspec takes it.

    A table whose kind is a user's class becomes a UserComponent; where tables of different kinds may stand, the kind
    alone is a table of nothing else; and where a list of such is expected, one alone is a list of one.
    """
    match info, value:
        case msgspec.inspect.Metadata(), _:
            return _folded(info.type, value)
        case msgspec.inspect.UnionType(), dict():
            structs = [one for one in info.types if isinstance(one, msgspec.inspect.StructType)]
            kind = value.get("kind")
            if isinstance(kind, str) and ":" in kind and any(one.cls is UserComponent for one in structs):
                parameters = {key: child for key, child in value.items() if key != "kind"}
                return {"kind": UserComponent.__struct_config__.tag, "name": kind, "parameters": parameters}
            chosen = [one for one in structs if one.tag is None or one.tag == kind]
            return _folded(chosen[0], value) if chosen else value
        case msgspec.inspect.UnionType(), str() if any(_tagged(one) for one in info.types):
            return _folded(info, {"kind": value})
        case msgspec.inspect.StructType(), dict():
            fields = {field.encode_name: field.type for field in info.fields}
            return {key: _folded(fields.get(key), child) for key, child in value.items()}
        case msgspec.inspect.VarTupleType(item_type=msgspec.inspect.UnionType()), dict() | str():
            return [_folded(info.item_type, value)]
        case msgspec.inspect.VarTupleType(), list():
            return [_folded(info.item_type, child) for child in value]
    return value


def _tagged(info: Any) -> bool:
    return isinstance(info, msgspec.inspect.StructType) and info.tag is not None


def _unfolded(value: Any) -> Any:
    """Return the tables of user's classes as they stand in a scenario file."""
    if isinstance(value, list | tuple):
        return [_unfolded(child) for child in value]
    if not isinstance(value, dict):
        return value
    if value.get("kind") == UserComponent.__struct_config__.tag:
        return {"kind": value["name"], **value["parameters"]}
    return {key: _unfolded(child) for key, child in value.items()}


def _apply(raw: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise ScenarioError(f"--set {override}: expected key=value, such as estimator.n=500")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    *parents, last = key.split(".")
    table: Any = raw
    for place, name in enumerate(parents):
        table = _child(table, name, ".".join(parents[: place + 1]), override)
    if isinstance(table, list):
        table[_index(table, last, key, override)] = value
    elif isinstance(table, dict):
        table[last] = value
    else:
        raise ScenarioError(f"--set {override}: {'.'.join(parents)} is {table!r}, which has no keys")


def _seen_from_here(raw: dict[str, Any], override: str) -> None:
    """Make paths of bitmaps that an override gives absolute: they are seen from the current folder."""
    key = override.partition("=")[0]
    names = raw.get("maps")
    if key.partition(".")[0] == "maps" and isinstance(names, list):
        which = range(len(names)) if key == "maps" else [int(key.removeprefix("maps."))]
        for place in which:
            if isinstance(names[place], str):
                names[place] = str(Path(names[place]).absolute())


def _child(table: Any, name: str, path: str, override: str) -> Any:
    if isinstance(table, list):
        return table[_index(table, name, path, override)]
    if isinstance(table, dict):
        return table.setdefault(name, {})
    raise ScenarioError(f"--set {override}: {path} lies inside {table!r}, which has no keys")


def _index(table: list[Any], name: str, path: str, override: str) -> int:
    if not name.isdecimal() or int(name) >= len(table):
        expected = f"expected an index from 0 to {len(table) - 1}, got {name!r}" if table else "the list is empty"
        raise ScenarioError(f"--set {override}: {path}: {expected}")
    return int(name)


def _unknown_keys(info: Any, value: Any, path: str) -> Iterator[str]:
    if isinstance(info, msgspec.inspect.Metadata):
        info = info.type
    if isinstance(info, msgspec.inspect.UnionType) and isinstance(value, dict):
        structs = [one for one in info.types if isinstance(one, msgspec.inspect.StructType)]
        chosen = [one for one in structs if one.tag is None or one.tag == value.get("kind")]
        if structs and not chosen:
            tags = [str(one.tag) for one in structs]
            yield f"{path}.kind: {_expected(value.get('kind'), tags)}"
        elif chosen:
            yield from _unknown_keys(chosen[0], value, path)
    elif isinstance(info, msgspec.inspect.StructType) and isinstance(value, dict):
        fields = {field.encode_name: field.type for field in info.fields}
        known = [*fields, *([info.tag_field] if info.tag_field else [])]
        for key, child in value.items():
            here = f"{path}.{key}" if path else key
            if key in fields:
                yield from _unknown_keys(fields[key], child, here)
            elif key not in known:
                yield f"{here}: unknown key{_nearest(key, known)}"
    elif isinstance(info, msgspec.inspect.LiteralType) and value not in info.values:
        yield f"{path}: {_expected(value, [str(one) for one in info.values])}"
    elif isinstance(info, msgspec.inspect.VarTupleType) and isinstance(value, list):
        for place, child in enumerate(value):
            yield from _unknown_keys(info.item_type, child, f"{path}.{place}")


def _expected(value: Any, choices: Sequence[str]) -> str:
    given = "missing" if value is None else repr(value)
    close = difflib.get_close_matches(str(value), choices, n=1)
    return f"{given}; expected one of {', '.join(choices)}" + (f"; did you mean {close[0]!r}?" if close else "")


def _nearest(name: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}" if known else ""


def _explain(error: msgspec.ValidationError, raw: Mapping[str, Any]) -> str:
    text, _, place = str(error).partition(" - at `$")
    keys = re.findall(r"[^.\[\]`]+", place)
    value: Any = raw
    for key in keys:
        try:
            value = value[int(key)] if isinstance(value, list) else value[key]
        except (KeyError, IndexError, TypeError, ValueError):
            return f"{'.'.join(keys)}: {text}"
    shown = (
        "" if not keys or (isinstance(value, dict | list) and len(value) > 4) else f" {json.dumps(value, default=str)}:"
    )
    return f"{'.'.join(keys) or 'scenario'}:{shown} {text[:1].lower()}{text[1:]}"


def _contradictions(scenario: Scenario) -> Iterator[str]:
    nodes = scenario.nodes
    if not nodes or nodes[0] not in {"simulator", "sensors"}:
        yield "a run needs a source: a [simulator], or [sensors] that play a log"
    if isinstance(scenario.simulator, RoomConfig) and scenario.simulator.driver is not None and scenario.controller:
        yield "simulator.driver: the [controller] drives already"
    if scenario.needs_log and scenario.simulator is not None:
        yield "simulator: a run that plays a log (needs_log) has no simulator"
    if isinstance(scenario.sensors, LogSensorsConfig) != scenario.needs_log:
        yield "sensors.kind: 'log' and needs_log = true go together"
    yield from _faulty_faults(scenario)
    if isinstance(scenario.simulator, WorkspaceConfig) and scenario.task is None:
        yield "task: missing; the workspace simulator needs the parts and their goals"
    if scenario.maps and scenario.colon is None:
        yield "maps: bitmaps for the tube of [colon], which this run has not"
    if isinstance(scenario.estimator, LocalizationConfig):
        for key, name in scenario.estimator.user_classes:
            if not CLASS_NAME.fullmatch(name):
                yield f"{key}: {name!r}; expected package.module:Name"


def _faulty_faults(scenario: Scenario) -> Iterator[str]:
    first: dict[tuple[str, str], int] = {}
    for place, fault in enumerate(scenario.faults):
        if first.setdefault((fault.topic, fault.to), place) != place:
            yield f"faults.{place}: {fault.topic} to {fault.to} stands in faults.{first[fault.topic, fault.to]} already"
        if fault.topic not in TOPICS:
            yield f"faults.{place}.topic: unknown topic {fault.topic!r}{_nearest(fault.topic, list(TOPICS))}"
        if fault.to not in scenario.nodes:
            yield f"faults.{place}.to: {fault.to!r} is not a node of this run{_nearest(fault.to, scenario.nodes)}"


def override_resolved(resolved: str, overrides: Sequence[str], where: str) -> Scenario:
    """Return the scenario that a recording carries, with overrides applied, but without the content of its files.

    Raises ScenarioError naming ``where``.
    """
    try:
        raw = json.loads(resolved)
        if not isinstance(raw, dict):
            raise ScenarioError(f"{where}: its scenario is a {type(raw).__name__}, expected a table of keys")
        for override in overrides:
            _apply(raw, override)
        return parse_scenario(raw, where)
    except json.JSONDecodeError as error:
        raise ScenarioError(f"{where}: its scenario cannot be read: {error}") from error
    except RecursionError:
        raise ScenarioError(f"{where}: its scenario is nested too deeply") from None
