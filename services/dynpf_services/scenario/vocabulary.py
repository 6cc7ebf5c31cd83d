"""All that a scenario may hold, as one type: for the reference of its keys, and for a schema that editors read."""

from functools import reduce
from operator import or_
from typing import Any

import msgspec
from dynpf_protocol.topics import NODES

from dynpf_services.scenario.kinds import fact_kind, fact_names, node_kind, node_kinds
from dynpf_services.scenario.schema import RunTable
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["json_schema", "whole_type"]


def whole_type() -> type[msgspec.Struct]:
    """Return a struct of all keys: those of the run, the tables that nodes share, and a section for each usual node."""
    shared = [(name, fact_kind(name).type | None, None) for name in fact_names()]
    sections = [(name, _any_of([*node_kinds(name).values()]) | None, None) for name in NODES]
    return msgspec.defstruct(
        "Scenario", [*shared, *sections], bases=(RunTable,), frozen=True, kw_only=True, forbid_unknown_fields=True
    )


def _any_of(kinds: list[str]) -> Any:
    return reduce(or_, (node_kind(text).config for text in kinds))


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scenario file; editors that know TOML complete and check keys by it."""
    schema = msgspec.json.schema(whole_type())
    definitions, whole = schema["$defs"], schema["$defs"]["Scenario"]
    every = sorted({*node_kinds(None).values()})
    node = {"anyOf": [_reference(node_kind(text).config) for text in every] + [_own_node()]}
    for config in (node_kind(text).config for text in every):
        definitions[config.__name__]["properties"]["remap"] = _REMAP
    for name in NODES:
        whole["properties"][name]["anyOf"].append(_own_node())
    tables = {"type": "object", "additionalProperties": node}
    whole["properties"] |= {
        "nodes": {**tables, "description": "Further nodes, by name: a table for each"},
        "robots": {"type": "array", "items": {"type": "string"}, "description": "Names; each has the nodes of [robot]"},
        "robot": {**tables, "description": "The nodes that each of the robots has, by name"},
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A scenario of dynpf", **schema}


_REMAP = {
    "type": "object",
    "additionalProperties": {"type": "string"},
    "description": "Topics by the node's own names for them, where they are not the usual ones",
}


def _reference(kind: type) -> dict[str, str]:
    return {"$ref": f"#/$defs/{kind.__name__}"}


def _own_node() -> dict[str, Any]:
    kind = {"type": "string", "pattern": ":", "description": UserComponent.__doc__ or ""}
    return {"type": "object", "properties": {"kind": kind}, "required": ["kind"]}
