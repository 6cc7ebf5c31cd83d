"""Overrides of the command line: ``--set key=value`` changes one key of a scenario before it is checked."""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from dynpf_protocol.errors import ScenarioError

__all__ = ["apply_override", "overrides_of", "toml_value", "value_of"]


def overrides_of(settings: Mapping[str, Any]) -> list[str]:
    """Return the overrides that set keys to Python values; raises ScenarioError for a value that TOML does not have."""
    return [f"{key}={toml_value(key, value)}" for key, value in settings.items()]


def toml_value(key: str, value: Any) -> str:
    """Return a value as TOML has it; raises ScenarioError, naming ``key``, for one that TOML does not have."""
    match value:
        case bool():
            return json.dumps(value)
        case str():
            return _quoted(value)
        case int():
            return str(int(value))
        case float():
            return repr(float(value))
        case Mapping():
            inside = (f"{_quoted(str(name))} = {toml_value(key, inner)}" for name, inner in value.items())
            return f"{{ {', '.join(inside)} }}"
        case list() | tuple():
            return f"[{', '.join(toml_value(key, inner) for inner in value)}]"
    raise ScenarioError(f"{key}: {value!r} is a {type(value).__name__}; expected a number, a text, a list or a table")


def _quoted(text: str) -> str:
    """Return a text as TOML has it: as JSON has it, but that TOML takes DEL only escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def value_of(text: str) -> Any:
    """Return the value of ``key=text``: a value in TOML, or else the text itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def apply_override(raw: dict[str, Any], override: str) -> None:
    """Set one key of ``raw``; raises ScenarioError unless it is key=value and its parent is a table or a list.

    The number after a list's last one appends to it.
    """
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ScenarioError(f"--set {override}: expected key=value, such as estimator.n=500")
    if (dotted := re.sub(r"\[(\d+)\]", r".\1", key)) != key:
        raise ScenarioError(f"--set {override}: an item of a list is named by its number after a dot: {dotted}")
    value = value_of(text)
    *parents, last = key.split(".")
    table: Any = raw
    for depth, name in enumerate(parents, start=1):
        table = _child(table, name, ".".join(parents[:depth]), override)
    if isinstance(table, list):
        index = _index(table, last, key, override, appending=True)
        table[index : index + 1] = [value]
    elif isinstance(table, dict):
        table[last] = value
    else:
        raise ScenarioError(f"--set {override}: {'.'.join(parents)} is {table!r}, which has no keys")


def _child(table: Any, name: str, path: str, override: str) -> Any:
    if isinstance(table, list):
        return table[_index(table, name, path, override)]
    if isinstance(table, dict):
        return table.setdefault(name, {})
    raise ScenarioError(f"--set {override}: {path} lies inside {table!r}, which has no keys")


def _index(table: list[Any], name: str, path: str, override: str, *, appending: bool = False) -> int:
    if name.isdecimal() and int(name) < len(table) + appending:
        return int(name)
    expected = f"expected an index from 0 to {len(table) - 1}" if table else "the list is empty"
    more = f", or {len(table)} to append" if appending else ""
    raise ScenarioError(f"--set {override}: {path}: {expected}{more}; got {name!r}")
