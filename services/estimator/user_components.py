"""A user's own components: made from the tables that name them, and held to what their part in the filter asks for."""

from collections.abc import Mapping
from typing import Any

import msgspec

from services.errors import ScenarioError
from services.estimator.config import UserComponent

__all__ = ["Classes", "made", "required_methods"]

Classes = Mapping[str, type]
"""The user's classes, by the names that a scenario gives them."""


def made(table: UserComponent, key: str, roles: tuple[type, ...], classes: Classes, facts: Mapping[str, Any]) -> Any:
    """Return an object of the user's class that can play one of the ``roles``, Protocols.

    ``Name(Params(...))`` if the class has a msgspec struct ``Params``, else ``Name(**keys)``; and the facts of the run
    that its attribute ``uses`` names, such as the map's "grid", as keywords. Raises ScenarioError that names the key,
    the value and what is missing.
    """
    kind = classes[table.name]
    what = f"{key}.kind: {table.name!r}"
    keywords = {}
    for name in getattr(kind, "uses", ()):
        if name not in facts:
            raise ScenarioError(f"{what} uses {name!r}; what there is to use: {', '.join(facts)}")
        if facts[name] is None:
            raise ScenarioError(f"{what} uses {name!r}, which this run lacks: {_LACKING.get(name, 'it has none')}")
        keywords[name] = facts[name]
    params = getattr(kind, "Params", None)
    try:
        if isinstance(params, type) and issubclass(params, msgspec.Struct):
            component = kind(_checked(table, key, params), **keywords)
        else:
            component = kind(**table.parameters, **keywords)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{what} cannot be made of the table's keys: {error}") from error
    lacks = {role: [name for name in required_methods(role) if not hasattr(component, name)] for role in roles}
    if all(lacks.values()):
        missing = " or ".join(", ".join(names) for names in lacks.values())
        asked = " or ".join(f"a {role.__name__}, which has {', '.join(required_methods(role))}" for role in roles)
        raise ScenarioError(f"{what} lacks {missing}; expected {asked}")
    return component


def required_methods(role: type) -> list[str]:
    """Return the names of what a Protocol asks for."""
    protocols = [base for base in reversed(role.__mro__) if getattr(base, "_is_protocol", False)]
    return [name for base in protocols for name in vars(base) if not name.startswith("_")]


_LACKING = {
    "landmarks": "there are no [[landmarks]]",
    "grid": "there is no [map]",
    "segments": "there is no [map] of segments",
}


def _checked(table: UserComponent, key: str, params: type[msgspec.Struct]) -> msgspec.Struct:
    known = {field.encode_name for field in msgspec.structs.fields(params)}
    for name in table.parameters:
        if name not in known:
            raise ScenarioError(f"{key}.{name}: unknown key; {table.name} knows {', '.join(sorted(known)) or 'none'}")
    try:
        return msgspec.convert(table.parameters, params)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `$")
        path = key + place.rstrip("`")
        raise ScenarioError(f"{path}: {text[:1].lower()}{text[1:]}") from error
