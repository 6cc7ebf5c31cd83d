"""Reads the parameters of AMCL from a YAML file of ROS 1 or 2, as data, each checked."""

import difflib
from collections.abc import Iterator
from typing import Any, NamedTuple

from dynpf.maps.yaml_text import mapping, short
from dynpf_systems.rooms.amcl.parameters import NAMES, PARAMETERS, ROS1_NAMES

__all__ = ["Given", "Parameters", "read_parameters"]

NODE = "amcl"
ROS2 = "ros__parameters"
LONGEST = 2**18
"""Characters of a file, which take half a second to read; the parameters of all of Nav2 have a tenth of that."""
DEPTH = 4
MANY = 10_000
"""Keys of a section, beyond which nothing that ROS has written goes."""


class Given(NamedTuple):
    """A parameter as the file has it: its name there, and its value as text."""

    name: str
    text: str


class Parameters(NamedTuple):
    """The values of all parameters by nav2's names, and which of them the file gives; ``unknown`` are no parameters."""

    values: dict[str, Any]
    given: dict[str, Given]
    unknown: tuple[tuple[Given, str], ...]  # with a hint
    ros1: bool


def read_parameters(text: str, name: str) -> Parameters:
    """Return the parameters in a file's ``text``; ``name`` is what errors call the file.

    The section of the node amcl is taken, with or without ros__parameters, in whichever namespace, or else the keys of
    the file itself. Raises ValueError with a line for each problem: the file, the key, its value and what was expected.
    """
    kind = "file of AMCL's parameters"
    document = mapping(text, name, longest=LONGEST, kind=kind, such_as="amcl: ros__parameters:")
    section, ros1 = _section(document, name)
    given: dict[str, Given] = {}
    values: dict[str, Any] = {}
    unknown: list[tuple[Given, str]] = []
    problems: list[str] = []
    for key, value in _flat(section):
        ours = ROS1_NAMES.get(key, key)
        parameter = NAMES.get(ours)
        if parameter is None:
            close = difflib.get_close_matches(key, [*NAMES, *ROS1_NAMES], n=1)
            unknown.append((Given(key, short(value)), f"did you mean {close[0]}?" if close else ""))
            continue
        found = parameter.taken(value)
        if found is None:
            problems.append(f"{name}: {key} = {short(value)}; expected {parameter.expected}")
        elif ours in given:
            problems.append(f"{name}: {key} = {short(value)}; {given[ours].name} says it already")
        given[ours] = Given(key, short(value))
        values[ours] = found
    defaults = {parameter.name: parameter.ros1 if ros1 else parameter.default for parameter in PARAMETERS}
    if not problems:
        problems += _contradictions(defaults | values, name)
    if problems:
        raise ValueError("\n".join(problems[:20]))
    return Parameters(defaults | values, given, tuple(unknown), ros1)


def _contradictions(values: dict[str, Any], name: str) -> Iterator[str]:
    least, most = values["min_particles"], values["max_particles"]
    if least > most:
        yield f"{name}: min_particles = {least}; expected no more than max_particles, which is {most}"
    slow, fast = values["recovery_alpha_slow"], values["recovery_alpha_fast"]
    if 0.0 < fast <= slow:
        yield f"{name}: recovery_alpha_slow = {slow:g}; expected less than recovery_alpha_fast, which is {fast:g}"
    if values["z_hit"] == values["z_rand"] == 0.0:
        yield f"{name}: z_hit = 0 and z_rand = 0; expected one of them above 0"


def _section(document: dict[Any, Any], name: str) -> tuple[dict[Any, Any], bool]:
    """Return the parameters of the one node amcl in a file, and whether they are ROS 1's."""
    found = list(_nodes(document))
    if len(found) > 1:
        listed = ", ".join(path for path, _ in found[:8])
        raise ValueError(f"{name}: has parameters of {len(found)} nodes ({listed}); expected one: keep one of them")
    section = found[0][1] if found else document
    inner = section.get(ROS2, section)
    if not isinstance(inner, dict) or len(inner) > MANY:
        raise ValueError(f"{name}: {ROS2} = {short(inner)}; expected the parameters of {NODE}, at most {MANY}")
    if not found and not any(key in NAMES or key in ROS1_NAMES or key == "initial_pose" for key, _ in _flat(inner)):
        there = ", ".join(short(key) for key in list(document)[:8]) or "nothing"
        raise ValueError(f"{name}: no parameter of AMCL in it; expected a section {NODE}: , the file has {there}")
    ros1 = inner is section and any(key in ROS1_NAMES for key, _ in _flat(inner))
    return inner, ros1


def _nodes(document: dict[Any, Any]) -> Iterator[tuple[str, dict[Any, Any]]]:
    """Yield the sections of nodes that are called amcl, each with its path; references are followed once."""
    waiting: list[tuple[str, dict[Any, Any], int]] = [("", document, 0)]
    seen: set[int] = set()
    while waiting:
        path, table, depth = waiting.pop(0)
        if id(table) in seen:
            continue
        seen.add(id(table))
        for key, value in table.items():
            if not isinstance(value, dict) or not isinstance(key, str):
                continue
            inner = f"{path}/{key.strip('/')}"
            if inner.rpartition("/")[2] == NODE:
                yield inner, value
            elif depth < DEPTH and key != ROS2:
                waiting.append((inner, value, depth + 1))


def _flat(section: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    """Yield keys and values; those of a table within have its name before a point."""
    for key, value in section.items():
        name = str(key).removeprefix("~").strip("/")
        if isinstance(value, dict):
            yield from ((f"{name}.{inner}", deep) for inner, deep in list(value.items())[:MANY])
        else:
            yield name, value
