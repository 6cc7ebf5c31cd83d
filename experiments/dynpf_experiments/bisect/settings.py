"""The settings in which two recorded scenarios differ, and scenarios that have some of each."""

import json
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any, NamedTuple

from dynpf_protocol.errors import ScenarioError
from msgspec import UNSET

__all__ = ["LOG", "Change", "changes", "mixed", "settings_of"]

LOG = "log_digest"
"""The key that stands for the log that a run plays."""

_COMPUTED = ("user_code",)  # what a file says here does not count


class Change(NamedTuple):
    """A setting that differs: its place in the scenario, and both values; UNSET where a run does not have it.

    What belongs together is one setting: the table of a component of another kind, a list of another length.
    """

    path: tuple[str | int, ...]
    a: Any
    b: Any

    @property
    def key(self) -> str:
        """The key, as ``--set`` has it."""
        return ".".join(map(str, self.path))


def settings_of(text: str, where: str) -> dict[str, Any]:
    """Return the resolved scenario of a recording, with the tables of all nodes by name; raises ScenarioError."""
    try:
        raw = json.loads(text)
        nodes = raw.get("nodes", [])
        raw["nodes"] = {table["name"]: table for table in nodes}
    except (ValueError, RecursionError, AttributeError, TypeError, KeyError):
        raise ScenarioError(f"{where}: its scenario cannot be read; dynpf doctor tells what is wrong with it") from None
    assert isinstance(raw, dict)
    return {name: value for name, value in raw.items() if name not in _COMPUTED}


def changes(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Change, ...]:
    """Return the settings in which two scenarios differ, by key."""
    return tuple(sorted(_changes((), a, b), key=lambda change: change.key))


def _changes(path: tuple[str | int, ...], a: Any, b: Any) -> Iterator[Change]:
    if a == b and type(a) is type(b):
        return
    if isinstance(a, dict) and isinstance(b, dict) and a.get("kind") == b.get("kind"):
        for name in {**a, **b}:
            yield from _changes((*path, name), a.get(name, UNSET), b.get(name, UNSET))
    elif _are_tables(a) and _are_tables(b) and len(a) == len(b):
        for index, (left, right) in enumerate(zip(a, b, strict=True)):
            yield from _changes((*path, index), left, right)
    else:
        yield Change(path, a, b)


def _are_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)


def mixed(a: Mapping[str, Any], chosen: Iterable[Change]) -> str:
    """Return the scenario ``a`` as JSON text in which the chosen settings are those of the other run."""
    raw = deepcopy(dict(a))
    for change in chosen:
        *parents, last = change.path
        table: Any = raw
        for name in parents:
            table = table[name]
        if change.b is UNSET:
            table.pop(last, None)
        else:
            table[last] = change.b
    nodes = [*raw.pop("nodes").values()]
    return json.dumps({**raw, **({"nodes": nodes} if nodes else {})})
