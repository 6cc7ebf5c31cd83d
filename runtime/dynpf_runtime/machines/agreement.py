"""Checks that processes belong to the same run: finds the first key in which their resolved scenarios differ."""

import json
from collections.abc import Iterator
from typing import Any

__all__ = ["first_difference"]


def first_difference(ours: str, theirs: str) -> tuple[str, Any, Any] | None:
    """Return the first key in which two resolved scenarios differ, with both values, or None."""
    if ours == theirs:
        return None
    mine, other = dict(_leaves(json.loads(ours), "")), dict(_leaves(json.loads(theirs), ""))
    for key in sorted(mine.keys() | other.keys()):
        if mine.get(key) != other.get(key):
            return key, mine.get(key), other.get(key)
    return None


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    children: Iterator[tuple[Any, Any]]
    if isinstance(value, dict) and value:
        children = iter(value.items())
    elif isinstance(value, list) and value:
        children = iter(enumerate(value))
    else:
        yield path, value
        return
    for key, child in children:
        yield from _leaves(child, f"{path}.{key}" if path else str(key))
