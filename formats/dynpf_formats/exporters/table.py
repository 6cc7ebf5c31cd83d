"""The messages of a topic as a table: one row per message, one column per field.

Names of nested fields are joined by dots. Lists of a fixed length have one column per element; other lists stay one
value. A field that a message leaves out is empty.
"""

import csv
from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter
from typing import Any, TextIO

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.json_text import read_json
from msgspec import inspect as types

from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.stream import RecordedSchema

__all__ = ["columns", "header", "in_json", "message_of", "rows", "write_csv"]

Getter = Callable[[Any], Any]
Columns = Mapping[str, tuple[types.Type, Getter]]


def columns(recording: Recording, topic: str) -> Columns:
    """Return the columns of a topic's table by name: the type of the values, and the getter of a message's value.

    For a message type that dynpf does not have, the columns are the fields of the schema in the recording.
    """
    row = recording.topics.get(topic)
    if row is not None:
        return dict(_leaves(types.type_info(row.type), "", lambda message: message))
    return {name: (types.AnyType(), itemgetter(name)) for name in _fields(recording.schemas[topic])}


class _Described(msgspec.Struct):
    properties: dict[str, Any] = {}


def _fields(schema: RecordedSchema) -> list[str]:
    """Return the fields that a schema names, none if it is unreadable."""
    try:
        return [*read_json(schema.data, _Described).properties]
    except msgspec.DecodeError:
        return []


def message_of(recording: Recording, topic: str, payload: bytes) -> Any:
    """Return a decoded message of a topic; a dictionary if dynpf does not have its type."""
    return decode(topic, payload, recording.topics) if topic in recording.topics else read_json(payload, object)


def _leaves(info: types.Type, name: str, get: Getter) -> Iterator[tuple[str, tuple[types.Type, Getter]]]:
    match info:
        case types.StructType(fields=fields):
            for field in fields:
                inner = f"{name}.{field.name}" if name else field.name
                yield from _leaves(field.type, inner, _of_field(get, field.name))
        case types.VarTupleType(item_type=item, min_length=low, max_length=high) if low == high and low is not None:
            for index in range(low):
                yield from _leaves(item, f"{name}.{index}", _of_index(get, index))
        case _:
            yield name, (info, get)


def _of_field(get: Getter, name: str) -> Getter:
    def field(message: Any) -> Any:
        whole = get(message)
        value = None if whole is None else getattr(whole, name)
        return None if value is msgspec.UNSET else value

    return field


def _of_index(get: Getter, index: int) -> Getter:
    def item(message: Any) -> Any:
        whole = get(message)
        return None if whole is None else whole[index]

    return item


def rows(recording: Recording, topic: str) -> Iterator[list[Any]]:
    """Yield the messages in the order of the file: stamp in ns, stamp in s, sequence, and the columns."""
    getters = [get for _, get in columns(recording, topic).values()]
    for record in recording.messages(topic):
        message = message_of(recording, topic, record.payload)
        yield [record.stamp_ns, record.stamp_ns / 1e9, record.sequence, *(get(message) for get in getters)]


def header(recording: Recording, topic: str) -> list[str]:
    """Return the column names of ``rows``."""
    return ["stamp_ns", "stamp_s", "sequence", *columns(recording, topic)]


def write_csv(recording: Recording, topic: str, stream: TextIO) -> int:
    """Write the table, numbers with all their digits, lists as JSON; return the number of rows."""
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header(recording, topic))
    count = 0
    for row in rows(recording, topic):
        writer.writerow(
            [
                "" if value is None else value if isinstance(value, str | int | float) else in_json(value)
                for value in row
            ]
        )
        count += 1
    return count


def in_json(value: Any) -> str:
    """Return a value that fits no single cell, such as a list, as JSON."""
    return msgspec.json.encode(value).decode()
