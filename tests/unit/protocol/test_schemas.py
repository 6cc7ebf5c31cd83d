"""The schemas in a recording are what Foxglove and Lichtblick can read, and agree with Foxglove's own."""

import json
from collections.abc import Iterator
from typing import Any, ClassVar

import foxglove.messages
import pytest
from dynpf_formats.shipped import known_topics
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import Message
from dynpf_protocol.schemas import json_schema
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet

Schema = dict[str, Any]

KINDS = sorted({row.type for row in known_topics().values()}, key=lambda kind: kind.schema_name)
FOXGLOVE = [kind for kind in KINDS if kind.schema_name.startswith("foxglove.")]


def _every(schema: Schema) -> Iterator[Schema]:
    yield schema
    for inner in schema.get("properties", {}).values():
        yield from _every(inner)
    if "items" in schema:
        yield from _every(schema["items"])


@pytest.mark.parametrize("kind", [*KINDS, JournalEntry], ids=lambda kind: kind.schema_name)
def test_a_schema_stands_alone_and_says_the_type_of_everything(kind: type[Message]) -> None:
    text = json_schema(kind)
    schema = json.loads(text)
    assert schema["type"] == "object"
    assert schema["title"] == kind.schema_name
    assert set(schema["properties"]) == set(kind.__struct_fields__)
    for word in (b"$ref", b"$defs", b"prefixItems", b"anyOf", b"oneOf", b"allOf"):
        assert word not in text
    for inner in _every(schema):
        assert inner["type"] in {"object", "array", "string", "number", "integer", "boolean"}
        if inner["type"] == "array":
            assert isinstance(inner["items"], dict)
        if inner["type"] == "object":
            assert isinstance(inner["properties"], dict)


# What JSON makes of each kind of field, as Foxglove's own JSON schemas have it.
SCALARS = {
    FieldDescriptorProto.TYPE_DOUBLE: "number",
    FieldDescriptorProto.TYPE_FLOAT: "number",
    FieldDescriptorProto.TYPE_FIXED32: "integer",
    FieldDescriptorProto.TYPE_UINT32: "integer",
    FieldDescriptorProto.TYPE_INT32: "integer",
    FieldDescriptorProto.TYPE_ENUM: "integer",
    FieldDescriptorProto.TYPE_BOOL: "boolean",
    FieldDescriptorProto.TYPE_STRING: "string",
}
BASE64 = "string in base64"
TIMES = {".google.protobuf.Timestamp", ".google.protobuf.Duration"}
TIME = {"sec": "integer", "nsec": "integer"}


def _theirs(name: str) -> Any:
    """Return the shape of one of Foxglove's schemas: dicts for objects, lists for arrays, words for scalars."""
    schema = getattr(foxglove.messages, name).get_schema()
    files = FileDescriptorSet.FromString(schema.data).file
    known = dict(item for file in files for item in _messages(f".{file.package}", file.message_type))

    def shape(message: DescriptorProto) -> dict[str, Any]:
        return {field.name: repeated(field) for field in message.field}

    def repeated(field: FieldDescriptorProto) -> Any:
        return [one(field)] if field.label == FieldDescriptorProto.LABEL_REPEATED else one(field)

    def one(field: FieldDescriptorProto) -> Any:
        if field.type == FieldDescriptorProto.TYPE_MESSAGE:
            return TIME if field.type_name in TIMES else shape(known[field.type_name])
        return BASE64 if field.type == FieldDescriptorProto.TYPE_BYTES else SCALARS[field.type]

    assert schema.name == f"foxglove.{name}"
    return shape(known[f".foxglove.{name}"])


def _messages(prefix: str, messages: Any) -> Iterator[tuple[str, DescriptorProto]]:
    for message in messages:
        yield f"{prefix}.{message.name}", message
        yield from _messages(f"{prefix}.{message.name}", message.nested_type)


def _ours(schema: Schema) -> Any:
    if schema["type"] == "object":
        return {name: _ours(inner) for name, inner in schema["properties"].items()}
    if schema["type"] == "array":
        return [_ours(schema["items"])]
    return BASE64 if schema.get("contentEncoding") == "base64" else schema["type"]


@pytest.mark.parametrize("kind", FOXGLOVE, ids=lambda kind: kind.__name__)
def test_a_foxglove_message_has_foxgloves_own_shape(kind: type[Message]) -> None:
    assert _ours(json.loads(json_schema(kind))) == _theirs(kind.__name__)


def test_the_comparison_sees_a_renamed_a_missing_and_a_mistyped_field() -> None:
    class Renamed(Message, frozen=True, kw_only=True):
        schema_name: ClassVar[str] = "foxglove.Vector3"
        x: float
        y: float
        height: float

    class Missing(Message, frozen=True, kw_only=True):
        schema_name: ClassVar[str] = "foxglove.Vector3"
        x: float
        y: float

    class Mistyped(Message, frozen=True, kw_only=True):
        schema_name: ClassVar[str] = "foxglove.Vector3"
        x: float
        y: float
        z: int

    class Right(Message, frozen=True, kw_only=True):
        schema_name: ClassVar[str] = "foxglove.Vector3"
        x: float
        y: float
        z: float

    assert _ours(json.loads(json_schema(Right))) == _theirs("Vector3")
    for wrong in (Renamed, Missing, Mistyped):
        assert _ours(json.loads(json_schema(wrong))) != _theirs("Vector3")


def test_the_scene_and_the_image_among_others_are_compared() -> None:
    assert {"CompressedImage", "FrameTransforms", "LaserScan", "Log", "PoseInFrame", "PosesInFrame", "SceneUpdate"} == {
        kind.__name__ for kind in FOXGLOVE
    }
    assert _theirs("CompressedImage")["data"] == BASE64
    assert isinstance(_theirs("SceneUpdate")["entities"], list)
