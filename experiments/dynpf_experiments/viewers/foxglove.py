"""A run as an MCAP file for Foxglove, Lichtblick and Rerun: protobuf in Foxglove's schemas, numbers as JSON."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import foxglove.messages as sdk
import msgspec
from mcap.writer import CompressionType, Writer

from dynpf_experiments.viewers.items import Item, Number, Plain

__all__ = ["NUMBER_SCHEMA", "encoded", "schema_of", "write_foxglove"]

NUMBER_SCHEMA = (
    b'{"type":"object","properties":{"value":{"type":"number"},"text":{"type":"string"}},"title":"dynpf.Number"}'
)
_ANY_SCHEMA = b'{"type":"object"}'

_ENUMS: dict[tuple[str, str], list[Any]] = {
    ("SceneEntityDeletion", "type"): [sdk.SceneEntityDeletionType.MatchingId, sdk.SceneEntityDeletionType.All],
    ("LinePrimitive", "type"): [
        sdk.LinePrimitiveLineType.LineStrip,
        sdk.LinePrimitiveLineType.LineLoop,
        sdk.LinePrimitiveLineType.LineList,
    ],
    ("Log", "level"): [
        getattr(sdk.LogLevel, name) for name in ("Unknown", "Debug", "Info", "Warning", "Error", "Fatal")
    ],
    ("PackedElementField", "type"): [
        getattr(sdk.PackedElementFieldNumericType, name)
        for name in ("Unknown", "Uint8", "Int8", "Uint16", "Int16", "Uint32", "Int32", "Float32", "Float64")
    ],
}


def write_foxglove(shown: Iterable[Item], path: Path) -> int:
    """Write a file with what viewers are shown, and return the number of messages; raises OSError."""
    with path.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="dynpf")
        channels: dict[str, int] = {}
        schemas: dict[tuple[str, bytes], int] = {}
        count = 0
        for count, item in enumerate(shown, start=1):
            encoding, name, schema_encoding, schema = schema_of(item)
            if item.topic not in channels:
                key = (name, schema)
                if key not in schemas:
                    schemas[key] = writer.register_schema(name, schema_encoding, schema)
                channels[item.topic] = writer.register_channel(item.topic, encoding, schemas[key])
            stamp = item.stamp_ns
            writer.add_message(channels[item.topic], stamp, encoded(item), stamp, count)
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def schema_of(item: Item) -> tuple[str, str, str, bytes]:
    """Return the encoding of an item's messages, and name, encoding and text of their schema."""
    match item.shown:
        case Number():
            return "json", "dynpf.Number", "jsonschema", NUMBER_SCHEMA
        case Plain(schema=None):
            return "json", "dynpf.Numbers", "jsonschema", _ANY_SCHEMA
        case Plain(schema=known):
            assert known is not None
            return "json", known.name, "jsonschema", known.data
    schema = _type(item.shown).get_schema()
    return "protobuf", schema.name, schema.encoding, schema.data


def encoded(item: Item) -> bytes:
    """Return an item as bytes: of the recording's JSON, or protobuf."""
    match item.shown:
        case Number(value=value, text=text):
            return msgspec.json.encode({"value": value, "text": text})
        case Plain(data=data):
            return data
    data = _sdk(item.shown).encode()
    assert isinstance(data, bytes)
    return data


def _type(message: Any) -> Any:
    return getattr(sdk, type(message).__name__)


def _sdk(value: Any) -> Any:
    """Return a message as the SDK's class of the same name and fields."""
    if isinstance(value, tuple):
        return [_sdk(each) for each in value]
    if not isinstance(value, msgspec.Struct):
        return value
    name = type(value).__name__
    fields = {field: _field(name, field, getattr(value, field)) for field in value.__struct_fields__}
    make: Callable[..., Any] = _type(value)
    return make(**fields)


def _field(name: str, field: str, value: Any) -> Any:
    choices = _ENUMS.get((name, field))
    return _sdk(value) if choices is None else choices[int(value)]
