"""What code a recording names: read from its scenario's text alone, whether or not that could be run."""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from dynpf_protocol.topics import NODES

from dynpf_formats.recording.reader import Recording
from dynpf_formats.user_classes import CLASS_NAME, UserClass, is_standard

__all__ = ["code_in_words", "described_code", "recorded_code"]


def recorded_code(recording: Recording) -> tuple[UserClass, ...]:
    """Return the classes that a replay would import and run, if it were allowed to; none of them is looked for."""
    try:
        scenario = json.loads(recording.header.scenario)
    except (ValueError, RecursionError):
        return ()  # of such a scenario nothing can be run
    tables = _node_tables(scenario) if isinstance(scenario, dict) else ()
    return tuple(user for key, table in tables for user in _of_node(key, table))


def _node_tables(scenario: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the tables of nodes, each with its key: those with usual names, and the others, listed or by name.

    A kind may stand there alone.
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
    """Yield what a node's table names: the node itself, whose other keys are its own matter, or its components."""
    kind = table.get("kind")
    if isinstance(kind, str) and CLASS_NAME.fullmatch(kind):
        yield from _named(key, table)
        return
    for field, component in table.items():
        if field not in ("kind", "name", "remap"):
            yield from _named(f"{key}.{field}", component)


def _named(key: str, table: Any) -> Iterator[UserClass]:
    """Yield what one component's table names, or each of a list of them; a kind may stand there alone."""
    listed = [(f"{key}.{index}", one) for index, one in enumerate(table)] if isinstance(table, list) else [(key, table)]
    for where, one in listed:
        kind = one.get("kind") if isinstance(one, dict) else one
        if isinstance(kind, str) and CLASS_NAME.fullmatch(kind):
            module, _, name = kind.partition(":")
            yield UserClass(f"{where}.kind", module, name)


def described_code(named: Iterable[UserClass]) -> list[dict[str, str]]:
    """Return what a replay would import and run, as ``info`` and ``doctor`` print it with --json."""
    return [{"key": one.key, "module": one.module, "class": one.name} for one in named]


def code_in_words(code: Iterable[dict[str, str]]) -> list[str]:
    """Return what a replay would import and run as lines for a person."""
    lines = []
    for one in code:
        module = one["module"]
        allowed = "replay refuses" if is_standard(module) else f"replay runs only with --allow-code {module}"
        lines.append(f"code: {one['key']} names the class {one['class']} of the module {module}, which {allowed}")
    return lines
