"""The summary at the end of an MCAP file: where each chunk is and which channels are in it, every length checked.

Its checksum covers all of it. It says nothing that the chunks do not say themselves, and what it says of them may be
wrong all the same: who uses it checks what is in the chunks.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, MetadataIndex, Schema

from dynpf_formats.recording.mcap_records import MAGIC, MAX_RECORD, Region, unpack

__all__ = ["Chunk", "Summary", "read_chunk", "read_metadata", "read_summary"]

_FRAME = struct.Struct("<BQ")
_FOOTER = struct.Struct("<QQI")
_CHUNK = struct.Struct("<QQQQI")  # times of the first and the last message, offset, length, length of what follows
_OFFSET = struct.Struct("<HQ")  # channel, and where the index of its messages is
_TAIL = _FRAME.size + _FOOTER.size + len(MAGIC)


class Chunk(NamedTuple):
    """Where the record of a chunk begins, its length with the frame, and the channels of its messages."""

    offset: int
    length: int
    channels: frozenset[int]


class Summary(NamedTuple):
    """What a summary says; ``metadata`` has the records with that name by their offset and length."""

    chunks: tuple[Chunk, ...]  # in the order of the file
    channels: tuple[Channel, ...]
    schemas: tuple[Schema, ...]
    metadata: tuple[tuple[str, int, int], ...]


def read_summary(stream: BinaryIO, size: int) -> Summary:
    """Return the summary of a file of ``size`` bytes; raises ValueError if it has none that can be used."""
    tail = _read(stream, max(0, size - _TAIL), _TAIL)
    opcode, length = _FRAME.unpack_from(tail)
    if opcode != Opcode.FOOTER or length != _FOOTER.size or not tail.endswith(MAGIC):
        raise ValueError("the file does not end with its footer")
    start, _, crc = _FOOTER.unpack_from(tail, _FRAME.size)
    end = size - _TAIL
    if not 0 < start <= end or end - start > MAX_RECORD:
        raise ValueError("it has no summary")
    data = _read(stream, start, end - start)
    if crc not in (0, zlib.crc32(tail[: _FRAME.size + _FOOTER.size - 4], zlib.crc32(data))):
        raise ValueError("the checksum of its summary does not match")
    try:
        return _parsed(data, start)
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise ValueError(f"its summary is unreadable: {str(error) or type(error).__name__}") from error


def read_chunk(stream: BinaryIO, chunk: Chunk) -> Region:
    """Return a chunk of the summary; raises ValueError if there is none, or a damaged one."""
    body = _record(stream, Opcode.CHUNK, chunk.offset, chunk.length)
    return Region(chunk.offset + _FRAME.size, len(body), unpack(body))


def read_metadata(stream: BinaryIO, offset: int, length: int) -> dict[str, str]:
    """Return the entries of a metadata record; raises ValueError if there is none."""
    body = _record(stream, Opcode.METADATA, offset, length)
    try:
        return dict(Metadata.read(ReadDataStream(BytesIO(body))).metadata)
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise ValueError("its metadata are unreadable") from error


def _parsed(data: bytes, most: int) -> Summary:
    chunks: list[Chunk] = []
    channels: list[Channel] = []
    schemas: list[Schema] = []
    metadata: list[tuple[str, int, int]] = []
    free = len(MAGIC)  # the first byte that no chunk has taken
    for opcode, body in _records(data):
        if opcode == Opcode.CHUNK_INDEX:
            chunk = _chunk(body)
            if not free <= chunk.offset <= most - chunk.length:
                raise ValueError("the chunks of its summary are out of order, or not in the file")
            free = chunk.offset + chunk.length
            chunks.append(chunk)
        elif opcode == Opcode.CHANNEL:
            channels.append(Channel.read(ReadDataStream(BytesIO(body))))
        elif opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(ReadDataStream(BytesIO(body))))
        elif opcode == Opcode.METADATA_INDEX:
            found = MetadataIndex.read(ReadDataStream(BytesIO(body)))
            metadata.append((found.name, found.offset, found.length))
    return Summary(tuple(chunks), tuple(channels), tuple(schemas), tuple(metadata))


def _chunk(body: bytes) -> Chunk:
    _, _, offset, length, size = _CHUNK.unpack_from(body)
    offsets = body[_CHUNK.size : _CHUNK.size + size]
    return Chunk(offset, length, frozenset([channel for channel, _ in _OFFSET.iter_unpack(offsets)]))


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(data):
        opcode, length = _FRAME.unpack_from(data, position)
        position += _FRAME.size
        if length > len(data) - position:
            raise ValueError("a record of its summary is cut short")
        yield opcode, data[position : position + length]
        position += length


def _record(stream: BinaryIO, expected: Opcode, offset: int, length: int) -> bytes:
    """Return the body of the record at ``offset``, whose length with its frame is ``length``."""
    if not _FRAME.size <= length <= MAX_RECORD:
        raise ValueError(f"its summary names a record of {length} bytes")
    data = _read(stream, offset, length)
    if _FRAME.unpack_from(data) != (expected, length - _FRAME.size):
        raise ValueError("its summary names a record that is not there")
    return data[_FRAME.size :]


def _read(stream: BinaryIO, offset: int, length: int) -> bytes:
    stream.seek(offset)
    data = stream.read(length)
    if len(data) != length:
        raise ValueError("it is shorter than its summary says")
    return data
