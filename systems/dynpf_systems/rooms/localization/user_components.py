"""A user's own components: built from the tables that name them, and checked against their role in the filter."""

from collections.abc import Mapping
from typing import Any

import msgspec
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["Classes", "made", "required_methods"]

Classes = Mapping[str, type]
"""The user's classes, by the names that a scenario gives them."""


def made(table: UserComponent, key: str, roles: tuple[type, ...], classes: Classes, facts: Mapping[str, Any]) -> Any:
    """Return an object of the user's class that fulfils one of the ``roles``, which are Protocols.

    It is ``Name(Params(...))`` if the class has a msgspec struct ``Params``, else ``Name(**keys)``; the facts of the
    run named by its attribute ``uses``, such as the map's "grid", are passed as keywords. A class that fulfils none of
    the roles is not called. Raises ScenarioError that names the key, the value and what is missing.
    """
    kind = classes[table.name]
    what = f"{key}.kind: {table.name!r}"
    _check_role(kind, what, roles)
    params = getattr(kind, "Params", None)
    if params is not None and not (isinstance(params, type) and issubclass(params, msgspec.Struct)):
        raise ScenarioError(f"{what} has Params = {params!r}; expected a msgspec struct, or no Params")
    uses = getattr(kind, "uses", ())
    if not isinstance(uses, tuple | list) or not all(isinstance(name, str) for name in uses):
        raise ScenarioError(f"{what} has uses = {uses!r}; expected a tuple of names")
    keywords = {}
    for name in uses:
        if name not in facts:
            raise ScenarioError(f"{what} uses {name!r}; what there is to use: {', '.join(facts)}")
        if facts[name] is None:
            raise ScenarioError(f"{what} uses {name!r}, which this run lacks: {_LACKING.get(name, 'it has none')}")
        keywords[name] = facts[name]
    try:
        if params is not None:
            return kind(_checked(table, key, params), **keywords)
        return kind(**table.parameters, **keywords)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{what} cannot be made of the table's keys: {error}") from error


def _check_role(kind: type, what: str, roles: tuple[type, ...]) -> None:
    """Raise ScenarioError for a class that lacks methods of every role; the class is not called."""
    lacks = [[name for name in required_methods(role) if not _has_method(kind, name)] for role in roles]
    if all(lacks):
        missing = " or ".join(", ".join(names) for names in lacks)
        asked = " or ".join(f"a {role.__name__}, which has {', '.join(required_methods(role))}" for role in roles)
        raise ScenarioError(f"{what} lacks {missing}; expected {asked}")


def _has_method(kind: type, name: str) -> bool:
    found = next((vars(base)[name] for base in kind.__mro__ if name in vars(base)), None)
    return callable(found) or isinstance(found, classmethod)


def required_methods(role: type) -> list[str]:
    """Return the names of the methods and attributes that a Protocol requires."""
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
        text, _, where = str(error).partition(" - at `$")
        path = key + where.rstrip("`")
        raise ScenarioError(f"{path}: {text[:1].lower()}{text[1:]}") from error
