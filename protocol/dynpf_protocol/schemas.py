"""JSON Schemas of the messages as Foxglove and Lichtblick read them.

msgspec writes a root ``$ref`` with shared definitions, enums without a type and bare ``prefixItems``. Foxglove wants a
root of type object, Lichtblick follows no ``$ref`` at all: so every reference is replaced by its definition.
"""

from typing import Any

import msgspec

from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import Message

__all__ = ["json_schema"]

Schema = dict[str, Any]

_KEPT = ("type", "title", "description", "properties", "required", "items", "enum", "contentEncoding")


def json_schema(kind: type[Message] | type[JournalEntry]) -> bytes:
    """Return the self-contained JSON Schema of a message type, without any ``$ref``."""
    _, definitions = msgspec.json.schema_components([kind])
    schema = _inline({"$ref": f"#/$defs/{kind.__name__}"}, definitions)
    schema["title"] = kind.schema_name
    return msgspec.json.encode(schema)


def _inline(schema: Schema, definitions: dict[str, Schema]) -> Schema:
    if "$ref" in schema:
        return _inline(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    flat = {key: schema[key] for key in _KEPT if key in schema}
    if "enum" in flat and "type" not in flat:
        flat["type"] = "integer" if all(isinstance(value, int) for value in flat["enum"]) else "string"
    if "properties" in flat:
        flat["properties"] = {name: _inline(sub, definitions) for name, sub in flat["properties"].items()}
    if isinstance(flat.get("items"), dict):
        flat["items"] = _inline(flat["items"], definitions)
    if flat.get("type") == "object" and "properties" not in flat:
        flat["properties"] = {}
    return flat
