"""Parameters checked when a component is made, as they are when a scenario file is read."""

import math
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
import numpy as np

__all__ = ["infinite_numbers", "validated"]

P = TypeVar("P", bound=msgspec.Struct)


def validated(params: P) -> P:
    """Return ``params`` if every number is finite and lies in the range that its struct declares.

    Raises ValueError with the struct, the parameter, its value and what was expected.
    """
    built: Any = msgspec.to_builtins(params, enc_hook=_plain)
    try:
        msgspec.convert(built, type(params))
    except msgspec.ValidationError as error:
        what, _, path = str(error).partition(" - at `$.")
        name = path.rstrip("`")
        value = _value(built, name) if name else built
        raise ValueError(f"{type(params).__name__}.{name} = {value!r}: {what[0].lower()}{what[1:]}") from None
    for name, number in infinite_numbers(built):
        raise ValueError(f"{type(params).__name__}.{name} = {number!r}: expected a finite number")
    return params


def infinite_numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers in nested tables and lists that are infinite or none, each with its path, such as ``a.b.0``."""
    match value:
        case float() if not math.isfinite(value):
            yield path, value
        case dict():
            for key, child in value.items():
                yield from infinite_numbers(child, f"{path}.{key}" if path else str(key))
        case list() | tuple():
            for place, child in enumerate(value):
                yield from infinite_numbers(child, f"{path}.{place}")


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is a {type(value).__name__}; expected a number, a text or a sequence of such")


def _value(built: Any, path: str) -> Any:
    for key in path.replace("[", ".").replace("]", "").split("."):
        built = built[int(key)] if isinstance(built, list | tuple) else built[key]
    return built
