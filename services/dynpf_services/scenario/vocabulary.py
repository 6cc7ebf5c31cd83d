"""The type of all keys that a scenario may have, for the reference of its keys and for a schema for editors."""

from functools import reduce
from operator import or_
from typing import Any

import msgspec
from dynpf_protocol.topics import NODES

from dynpf_services.scenario.kinds import fact_kind, fact_names, node_kind, node_kinds
from dynpf_services.scenario.schema import RunTable
from dynpf_services.scenario.user_component import UserComponent

__all__ = ["json_schema", "whole_type"]

Schema = dict[str, Any]


def whole_type() -> type[msgspec.Struct]:
    """Return a struct of all keys: those of the run, the shared tables, and a section for each usual node."""
    shared = [(name, fact_kind(name).type | None, None) for name in fact_names()]
    sections = [(name, _any_of([*node_kinds(name).values()]) | None, None) for name in NODES]
    return msgspec.defstruct(
        "Scenario", [*shared, *sections], bases=(RunTable,), frozen=True, kw_only=True, forbid_unknown_fields=True
    )


def _any_of(kinds: list[str]) -> Any:
    return reduce(or_, (node_kind(text).config for text in kinds))


def json_schema() -> Schema:
    """Return the JSON schema of a scenario file, by which editors complete and check keys."""
    made = msgspec.json.schema(whole_type())
    definitions: dict[str, Schema] = made["$defs"]
    definitions[UserComponent.__name__] = _OWN
    definitions = {name: _with_short_forms(schema, definitions) for name, schema in definitions.items()}
    whole = definitions["Scenario"]["properties"]
    for name in NODES:
        whole[name]["anyOf"].append(_OWN)
        for text in {*node_kinds(name).values()}:
            definitions[node_kind(text).config.__name__]["properties"]["remap"] = _REMAP
    nodes = [_further(name, definitions[node_kind(text).config.__name__]) for name, text in node_kinds(None).items()]
    tables = {"type": "object", "additionalProperties": {"anyOf": [*nodes, _OWN, {"type": "string"}]}}
    whole |= {
        "nodes": {**tables, "description": "Further nodes, by name: a table for each"},
        "robots": {"type": "array", "items": {"type": "string"}, "description": "Names; each has the nodes of [robot]"},
        "robot": {**tables, "description": "The nodes that each of the robots has, by name"},
    }
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A scenario of dynpf"}
    return {**head, **made, "$defs": definitions}


_OWN: Schema = {
    "type": "object",
    "properties": {"kind": {"type": "string", "pattern": ":", "description": "A class of your own: module:Name"}},
    "required": ["kind"],
}

_REMAP: Schema = {
    "type": "object",
    "additionalProperties": {"type": "string"},
    "description": "Topics by the node's own names for them, where they are not the usual ones",
}


def _further(name: str, table: Schema) -> Schema:
    """Return the table of a node with any name, whose kind is ``name``."""
    kind = {"kind": {"enum": [name]}}
    required = sorted({"kind", *table.get("required", ())})
    return {**table, "properties": {**table["properties"], **kind}, "required": required}


def _with_short_forms(schema: Any, definitions: dict[str, Schema]) -> Any:
    """Return a schema that also accepts the short forms of tables.

    These are: a kind alone if there are several, a table without its kind if there is only one, and a single table
    instead of a list.
    """
    if isinstance(schema, list):
        return [_with_short_forms(inner, definitions) for inner in schema]
    if not isinstance(schema, dict):
        return schema
    whole = {
        key: inner if key in ("anyOf", "discriminator") else _with_short_forms(inner, definitions)
        for key, inner in schema.items()
    }
    tables = _tables(schema, definitions)
    if len(tables) == 1:
        (table,) = tables
        bare = {**table, "required": [key for key in table.get("required", ()) if key != "kind"]}
        return {"anyOf": [whole, _with_short_forms(bare, definitions)]}
    if tables:
        alone = {"enum": [kind for table in tables for kind in table["properties"]["kind"].get("enum", ())]}
        whole["anyOf"] = [*whole["anyOf"], alone, {"type": "string", "pattern": ":"}]
    if schema.get("type") == "array" and _tables(schema.get("items"), definitions):
        return {"anyOf": [whole, whole["items"]]}
    return whole


def _tables(schema: Any, definitions: dict[str, Schema]) -> list[Schema]:
    """Return the tables with kinds among which a schema chooses, or the only one."""
    if not isinstance(schema, dict):
        return []
    choices = schema.get("anyOf", [schema])
    tables = [definitions.get(choice.get("$ref", "").rpartition("/")[2], {}) for choice in choices]
    return [table for table in tables if "kind" in table.get("properties", {})]
