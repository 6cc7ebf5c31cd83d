"""YAML files of others, read as data and within bounds: mappings, numbers, and values as errors show them."""

import math
from typing import Any

try:
    import yaml
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("maps of map_server need PyYAML: pip install 'dynpf[maps]'", name="yaml") from error

__all__ = ["mapping", "number", "short"]


def mapping(text: str, name: str, *, longest: int, kind: str, such_as: str) -> dict[Any, Any]:
    """Return the mapping that a YAML text of at most ``longest`` characters holds.

    ``name``, ``kind`` and ``such_as`` are the file, what it should be, and one of its keys, for errors. Raises
    ValueError, in one line.
    """
    if len(text) > longest:
        raise ValueError(f"{name}: {len(text)} characters; a {kind} has at most {longest}")
    try:
        document = yaml.safe_load(text.replace("\t", " "))  # other readers take tabs between a key and its value
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        what = " ".join(str(getattr(error, "problem", None) or error or type(error).__name__).split())
        raise ValueError(f"{name}{where}: not YAML: {what}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{name}: holds {short(document)}; expected the keys of a {kind}, such as {such_as}")
    return document


def number(value: Any) -> float | None:
    """Return a finite number, or None. Text too: to PyYAML 1e-2, without a point, is text."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        found = float(value)
    except (ValueError, OverflowError):
        return None
    return found if math.isfinite(found) else None


def short(value: Any) -> str:
    """Return a value as errors show it: nothing that is nested, since references in YAML can make that huge."""
    if isinstance(value, list):
        parts = ["[...]" if isinstance(part, list) else short(part) for part in value[:4]]
        return f"[{', '.join(parts)}{', ...' if len(value) > 4 else ''}]"
    text = "a mapping" if isinstance(value, dict) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
