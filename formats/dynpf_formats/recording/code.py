"""The user classes that a recording names, read from the text of its scenario, whether or not that can be run."""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from dynpf_protocol.topics import NODES

from dynpf_formats.recording.reader import Recording
from dynpf_formats.user_classes import CLASS_NAME, UserClass, is_standard

__all__ = ["code_in_words", "described_code", "recorded_code"]


def recorded_code(recording: Recording) -> tuple[UserClass, ...]:
    """Return the classes that a replay would import and run if allowed; none of them is imported here."""
    try:
        scenario = json.loads(recording.header.scenario)
    except (ValueError, RecursionError):
        return ()  # nothing of such a scenario can be run
    tables = _node_tables(scenario) if isinstance(scenario, dict) else ()
    return tuple(user for key, table in tables for user in _of_node(key, table))


def _node_tables(scenario: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the tables of nodes, each with its key: nodes with usual names, then the others, by list or by name.

    A kind alone, without a table, is allowed.
    """
    others = scenario.get("nodes")
    named = [*others.items()] if isinstance(others, dict) else []
    if isinstance(others, list):
        named = [(table.get("name"), table) for table in others if isinstance(table, dict)]
    tables = [(name, scenario.get(name)) for name in NODES] + [(f"nodes.{name}", table) for name, table in named]
    for key, table in tables:
        if isinstance(table, str):
            yield key, {"kind": table}
        elif isinstance(table, dict):
            yield key, table


def _of_node(key: str, table: dict[str, Any]) -> Iterator[UserClass]:
    """Yield the classes of a node's table: the node's own class, whose other keys are left alone, or its components."""
    kind = table.get("kind")
    if isinstance(kind, str) and CLASS_NAME.fullmatch(kind):
        yield from _named(key, table)
        return
    for field, component in table.items():
        if field not in ("kind", "name", "remap"):
            yield from _named(f"{key}.{field}", component)


def _named(key: str, table: Any) -> Iterator[UserClass]:
    """Yield the class of a component's table, or of each table in a list; a kind alone is allowed."""
    listed = (
        [(f"{key}.{index}", part) for index, part in enumerate(table)] if isinstance(table, list) else [(key, table)]
    )
    for where, component in listed:
        kind = component.get("kind") if isinstance(component, dict) else component
        if isinstance(kind, str) and CLASS_NAME.fullmatch(kind):
            module, _, name = kind.partition(":")
            yield UserClass(f"{where}.kind", module, name)


def described_code(named: Iterable[UserClass]) -> list[dict[str, str]]:
    """Return the classes that a replay would import and run, as ``info --json`` and ``doctor --json`` print them."""
    return [{"key": user.key, "module": user.module, "class": user.name} for user in named]


def code_in_words(code: Iterable[dict[str, str]]) -> list[str]:
    """Return the classes that a replay would import and run as lines for a person."""
    lines = []
    for row in code:
        module = row["module"]
        allowed = "replay refuses" if is_standard(module) else f"replay runs only with --allow-code {module}"
        lines.append(f"code: {row['key']} names the class {row['class']} of the module {module}, which {allowed}")
    return lines
