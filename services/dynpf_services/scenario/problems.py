"""Error texts for scenarios: the key, the value, what was expected, and the nearest known name."""

import difflib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynpf_services.scenario.user_component import UserComponent

if TYPE_CHECKING:
    from dynpf_services.scenario.schema import Scenario

__all__ = [
    "IMPORTED_LOG",
    "chosen_elsewhere",
    "explain",
    "faulty_faults",
    "folded",
    "nearest",
    "no_scenario",
    "not_one_of",
    "unfolded",
    "unknown_keys",
]


IMPORTED_LOG = (
    "an imported log, no run; dynpf run SCENARIO --log {} plays it, dynpf info and dynpf view show what is in it"
)
"""What to tell of a recording without a scenario, whose path goes into the braces."""


def folded(info: Any, value: Any) -> Any:
    """Return ``value`` in the form that msgspec converts, with short forms expanded.

    A table whose kind is a user class becomes a UserComponent. If tables of different kinds are allowed, a kind alone
    becomes a table; if a list of such tables is expected, a single one becomes a list.
    """
    match info, value:
        case msgspec.inspect.Metadata(), _:
            return folded(info.type, value)
        case msgspec.inspect.StructType(), dict() if info.cls is UserComponent:
            return _component(value)
        case msgspec.inspect.UnionType(), dict():
            structs = [choice for choice in info.types if isinstance(choice, msgspec.inspect.StructType)]
            kind = value.get("kind")
            if isinstance(kind, str) and ":" in kind and any(choice.cls is UserComponent for choice in structs):
                return _component(value)
            chosen = [choice for choice in structs if choice.tag is None or choice.tag == kind]
            return folded(chosen[0], value) if chosen else value
        case msgspec.inspect.UnionType(), str() if any(_tagged(choice) for choice in info.types):
            return folded(info, {"kind": value})
        case msgspec.inspect.StructType(), dict():
            fields = {field.encode_name: field.type for field in info.fields}
            return {key: folded(fields.get(key), child) for key, child in value.items()}
        case msgspec.inspect.VarTupleType(item_type=msgspec.inspect.UnionType()), dict() | str():
            return [folded(info.item_type, value)]
        case msgspec.inspect.VarTupleType(), list():
            return [folded(info.item_type, child) for child in value]
    return value


def _component(table: Mapping[str, Any]) -> dict[str, Any]:
    parameters = {key: child for key, child in table.items() if key != "kind"}
    return {"kind": UserComponent.__struct_config__.tag, "name": table["kind"], "parameters": parameters}


def _tagged(info: Any) -> bool:
    return isinstance(info, msgspec.inspect.StructType) and info.tag is not None


def unfolded(value: Any) -> Any:
    """Return ``value`` with the tables of user classes as in a scenario file."""
    if isinstance(value, list | tuple):
        return [unfolded(child) for child in value]
    if not isinstance(value, dict):
        return value
    if value.get("kind") == UserComponent.__struct_config__.tag:
        return {"kind": value["name"], **value["parameters"]}
    return {key: unfolded(child) for key, child in value.items()}


def unknown_keys(info: Any, value: Any, path: str) -> Iterator[str]:
    """Yield a text for every unknown key below ``path``, and for every value that is none of the expected ones."""
    if isinstance(info, msgspec.inspect.Metadata):
        info = info.type
    if isinstance(info, msgspec.inspect.UnionType) and isinstance(value, dict):
        structs = [choice for choice in info.types if isinstance(choice, msgspec.inspect.StructType)]
        chosen = [choice for choice in structs if choice.tag is None or choice.tag == value.get("kind")]
        if structs and not chosen:
            tags = [str(choice.tag) for choice in structs]
            yield f"{path}.kind: {not_one_of(value.get('kind'), tags)}"
        elif chosen:
            yield from unknown_keys(chosen[0], value, path)
    elif isinstance(info, msgspec.inspect.StructType) and isinstance(value, dict):
        fields = {field.encode_name: field.type for field in info.fields}
        known = [*fields, *([info.tag_field] if info.tag_field else [])]
        for key, child in value.items():
            here = f"{path}.{key}" if path else key
            if key in fields:
                yield from unknown_keys(fields[key], child, here)
            elif key not in known:
                yield f"{here}: unknown key{nearest(key, [*known, *_further_nodes(fields)])}"
    elif isinstance(info, msgspec.inspect.LiteralType) and value not in info.values:
        yield f"{path}: {not_one_of(value, [*map(str, info.values)])}"
    elif isinstance(info, msgspec.inspect.VarTupleType) and isinstance(value, list):
        for index, child in enumerate(value):
            yield from unknown_keys(info.item_type, child, f"{path}.{index}")


def _further_nodes(fields: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of the tables in [nodes], whose names alone are easily taken for their keys."""
    match fields.get("nodes"):
        case msgspec.inspect.StructType(fields=nodes):
            yield from (f"nodes.{node.encode_name}" for node in nodes)


def no_scenario(path: Path) -> str:
    """Return what a file that is no scenario probably is, and the command that takes it."""
    if path.is_dir() or path.suffix in {".bag", ".db3", ".log", ".clf"}:
        return (
            "a folder or a log, no scenario; dynpf localize takes a robot's log, dynpf import makes a recording of it"
        )
    if path.suffix in {".yaml", ".yml"}:
        return f"no scenario; AMCL's parameters become one by dynpf import amcl {path} -o MINE.toml"
    if path.suffix == ".mcap":
        return (
            f"a recording, no scenario; dynpf replay {path} executes its run again, dynpf view shows it, and "
            f"dynpf run SCENARIO --log {path} plays an imported log"
        )
    return "no scenario; expected a .toml file, or a name that dynpf list shows"


def faulty_faults(scenario: "Scenario") -> Iterator[str]:
    """Yield a text for each fault of a scenario that is there twice, or meets no node of the run."""
    first: dict[tuple[str, str], int] = {}
    for index, fault in enumerate(scenario.faults):
        if first.setdefault((fault.topic, fault.to), index) != index:
            yield f"faults.{index}: {fault.topic} to {fault.to} stands in faults.{first[fault.topic, fault.to]} already"
        if fault.to not in scenario.nodes:
            yield f"faults.{index}.to: {fault.to!r} is not a node of this run{nearest(fault.to, [*scenario.nodes])}"


def not_one_of(value: Any, choices: Sequence[str]) -> str:
    """Return the end of a sentence: that ``value`` is none of ``choices``."""
    given = "missing" if value is None else repr(value)
    close = difflib.get_close_matches(str(value), choices, n=1)
    return f"{given}; expected one of {', '.join(choices)}" + (f"; did you mean {close[0]!r}?" if close else "")


def chosen_elsewhere(value: str, configs: Mapping[str, type[msgspec.Struct]]) -> str:
    """Return the end of a sentence: which key of which kind of node takes ``value``, or one much like it; or ""."""
    for kind, config in configs.items():
        info = msgspec.inspect.type_info(config)
        for field in info.fields if isinstance(info, msgspec.inspect.StructType) else ():
            choices = field.type.types if isinstance(field.type, msgspec.inspect.UnionType) else ()
            tags = [str(choice.tag) for choice in choices if isinstance(choice, msgspec.inspect.StructType)]
            close = [tag for tag in tags if value and value in tag] or difflib.get_close_matches(value, tags, n=1)
            if close:
                return f"; {kind} has it as {field.encode_name} = {close[0]!r}"
    return ""


def nearest(name: str, known: Sequence[str]) -> str:
    """Return the end of a sentence: the known name nearest to ``name``, or all known names."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}" if known else ""


def explain(error: msgspec.ValidationError, raw: Mapping[str, Any]) -> str:
    """Return msgspec's error about ``raw`` as a text with key, value and what was expected."""
    text, _, where = str(error).partition(" - at `$")
    keys = re.findall(r"[^.\[\]`]+", where)
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
