"""The table of a topic as a Parquet file."""

from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow
from msgspec import inspect as types
from pyarrow.parquet import ParquetWriter

from dynpf_formats.exporters.table import columns, header, in_json, rows
from dynpf_formats.recording.errors import CorruptRecordingError
from dynpf_formats.recording.reader import Recording

__all__ = ["write_parquet"]

BATCH = 1000  # rows written at once


def write_parquet(recording: Recording, topic: str, path: Path) -> int:
    """Write the table, lists of numbers as lists, other lists as JSON; return the number of rows.

    Raises FileExistsError if ``path`` exists, OSError if it cannot be written, CorruptRecordingError for a whole number
    that has no place in it.
    """
    kinds = [
        pyarrow.int64(),
        pyarrow.float64(),
        pyarrow.int64(),
        *(_kind(info) for info, _ in columns(recording, topic).values()),
    ]
    schema = pyarrow.schema(list(zip(header(recording, topic), kinds, strict=True)))
    count = 0
    with path.open("xb") as file, ParquetWriter(file, schema) as writer:
        table = rows(recording, topic)
        while batch := list(islice(table, BATCH)):
            cells = zip(*batch, strict=True)
            try:
                arrays = [pyarrow.array(_column(column, kind), kind) for column, kind in zip(cells, kinds, strict=True)]
            except OverflowError as error:
                where = f"{recording.path}: {topic}"
                raise CorruptRecordingError(f"{where}: a whole number of 2^63 or more, which no table holds") from error
            writer.write_batch(pyarrow.record_batch(arrays, schema=schema))
            count += len(batch)
    return count


def _kind(info: types.Type) -> Any:
    match info:
        case types.FloatType():
            return pyarrow.float64()
        case types.IntType() | types.EnumType():
            return pyarrow.int64()
        case types.BoolType():
            return pyarrow.bool_()
        case types.BytesType():
            return pyarrow.binary()
        case types.VarTupleType(item_type=types.FloatType()):
            return pyarrow.list_(pyarrow.float64())
    return pyarrow.string()


def _column(column: tuple[Any, ...], kind: Any) -> list[Any]:
    if kind != pyarrow.string():
        return list(column)
    return [value if value is None or isinstance(value, str) else in_json(value) for value in column]
