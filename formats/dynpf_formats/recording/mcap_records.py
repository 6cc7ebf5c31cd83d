"""Scans an MCAP file from front to back: checks every length before it is used, and compares every checksum.

Damage is reported with its offset, as an item among the others, and the scan continues after it if the framing allows;
the caller decides what damage means. Memory is bounded by one record and one chunk, whatever a file claims.

The record layouts come from the mcap package. Its own StreamReader is not used because it reads as many bytes as a
file claims, accepts a truncated record as a whole one, and ignores the checksums of attachments.
"""

import struct
import zlib
from collections.abc import Iterator
from enum import StrEnum
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

__all__ = [
    "MAGIC",
    "MAX_ATTACHMENT",
    "MAX_RATIO",
    "MAX_RECORD",
    "MAX_UNPACKED",
    "Damage",
    "DamageKind",
    "End",
    "Item",
    "Message",
    "Region",
    "Stray",
    "contents",
    "scan",
    "unpack",
]

MAX_RECORD = 64 * 2**20
"""The largest record or chunk, compressed or not, in bytes."""

MAX_ATTACHMENT = 33 * 2**20
"""The largest attachment with its names, in bytes: a writer takes data of up to 32 MiB."""

MAX_UNPACKED, MAX_RATIO = 64 * 2**20, 200
"""The chunks of a file hold at most so many bytes, and besides so many times the file's size. Recordings are ten times
as large as their files."""

_FRAME = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_INDEX = struct.Struct("<HI")
_NOT_COMPUTED = 0  # a checksum, as MCAP has it: other writers may leave it out
_FOOTER_CRC = 4  # bytes at the end of the footer that its own checksum leaves out

# A chunk's record has, before the text "zstd": opcode, length, three times or sizes, checksum.
_ZSTD = b"\x04\x00\x00\x00zstd"
_CHUNK_TO_ZSTD = _FRAME.size + 8 + 8 + 8 + 4
_MAX_CANDIDATES = 100


class DamageKind(StrEnum):
    """What is wrong."""

    TRUNCATED = "truncated"  # the file ends too early
    CHECKSUM = "checksum"
    MALFORMED = "malformed"  # a record does not hold what its type promises
    OVERSIZE = "oversize"


class Damage(NamedTuple):
    """Something wrong at a byte offset of the file."""

    kind: DamageKind
    offset: int
    text: str


class Region(NamedTuple):
    """An undamaged chunk: offset and length of its body in the file, and its uncompressed records."""

    offset: int
    length: int
    data: bytes


class Message(NamedTuple):
    """A message inside a chunk; its payload is ``data[start:stop]``."""

    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    start: int
    stop: int


class Stray(NamedTuple):
    """A record outside a chunk, where recordings have none; it has no checksum of its own."""

    offset: int
    what: str
    topic: str


class End(NamedTuple):
    """The file has its footer and nothing after it."""


Item = Header | Metadata | Attachment | Schema | Channel | Region | Stray | End | Damage

_R = TypeVar("_R", bound=McapRecord)


class _BadError(Exception):
    def __init__(self, kind: DamageKind, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class _Body(ReadDataStream):
    """The body of one record, from which nothing can be read beyond its end."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise _BadError(DamageKind.MALFORMED, f"a field of {length} bytes where {len(data)} are left")
        return data


def scan(stream: BinaryIO, size: int) -> Iterator[Item]:
    """Yield the items of a file of ``size`` bytes, in order. The caller has checked the magic bytes at its start."""
    offset = len(MAGIC)
    data_crc: int | None = zlib.crc32(MAGIC)  # None: damaged, so the checksum over all data says nothing new
    summary_crc: int | None = None  # None: the summary has not begun
    left = MAX_UNPACKED + MAX_RATIO * size  # bytes that chunks may still hold
    while True:
        try:
            opcode, body = _frame(stream, offset, size)
            header = _FRAME.pack(opcode, len(body))
            if opcode == Opcode.FOOTER:
                _check_footer(stream, offset, size, body, summary_crc)
                yield End()
                return
            if opcode == Opcode.DATA_END:
                summary_crc = 0
                _check_data_end(body, data_crc)
            elif summary_crc is None:
                item = _data_record(opcode, body, offset, left)
                left -= len(item.data) if isinstance(item, Region) else 0
                if data_crc is not None:
                    data_crc = zlib.crc32(body, zlib.crc32(header, data_crc))
                if item is not None:
                    yield item
            else:
                summary_crc = zlib.crc32(body, zlib.crc32(header, summary_crc))
                if opcode == Opcode.CHANNEL:
                    yield _parse(Channel, body)
                elif opcode == Opcode.SCHEMA:
                    yield _parse(Schema, body)
            offset += _FRAME.size + len(body)
        except _BadError as bad:
            resumed = _resume(stream, offset, size)
            cut = bad.kind is DamageKind.TRUNCATED and resumed is not None  # not truncated after all: there is more
            yield Damage(DamageKind.MALFORMED if cut else bad.kind, offset, str(bad))
            if resumed is None:
                return
            data_crc = None
            offset = resumed


def contents(data: bytes) -> Iterator[Message | Schema | Channel]:
    """Yield the records of an uncompressed chunk; raises ValueError if they do not fit together."""
    start, size = 0, len(data)
    while start < size:
        if start + _FRAME.size > size:
            raise ValueError(f"a record is cut short at byte {start} of the chunk")
        opcode, length = _FRAME.unpack_from(data, start)
        start += _FRAME.size
        stop = start + length
        if stop > size:
            raise ValueError(f"a record of {length} bytes at byte {start} of a chunk of {size}")
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise ValueError(f"a message of {length} bytes at byte {start} of the chunk")
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            yield Message(channel_id, sequence, log_time, publish_time, start + _MESSAGE.size, stop)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            try:
                yield _parse(Schema, data[start:stop]) if opcode == Opcode.SCHEMA else _parse(Channel, data[start:stop])
            except _BadError as bad:
                raise ValueError(str(bad)) from bad
        else:
            raise ValueError(f"a record of type {opcode} in the chunk")
        start = stop


def unpack(body: bytes) -> bytes:
    """Return the uncompressed records of a chunk record with this body; raises ValueError if it is damaged."""
    try:
        return _uncompress(_parse(Chunk, body))
    except _BadError as bad:
        raise ValueError(str(bad)) from bad


def _frame(stream: BinaryIO, offset: int, size: int) -> tuple[int, bytes]:
    if offset + _FRAME.size > size:
        raise _BadError(DamageKind.TRUNCATED, "the file ends without its footer")
    stream.seek(offset)
    opcode, length = _FRAME.unpack(stream.read(_FRAME.size))
    if offset + _FRAME.size + length > size:
        raise _BadError(DamageKind.TRUNCATED, f"the file ends inside a record of {length} bytes")
    most = MAX_ATTACHMENT if opcode == Opcode.ATTACHMENT else MAX_RECORD
    if length > most:
        raise _BadError(DamageKind.OVERSIZE, f"a record of {length} bytes; at most {most} are read")
    body = stream.read(length)
    if len(body) != length:
        raise _BadError(DamageKind.TRUNCATED, "the file became shorter while it was read")
    return opcode, body


def _data_record(opcode: int, body: bytes, offset: int, left: int) -> Item | None:
    item: Item | None = None
    match opcode:
        case Opcode.HEADER if offset == len(MAGIC):
            item = _parse(Header, body)
        case Opcode.METADATA:
            item = _parse(Metadata, body)
        case Opcode.ATTACHMENT:
            item = _attachment(body)
        case Opcode.CHUNK:
            item = Region(offset + _FRAME.size, len(body), _uncompress(_parse(Chunk, body), left))
        case Opcode.MESSAGE_INDEX:
            _check_message_index(body)
        case Opcode.SCHEMA:
            item = Stray(offset, "schema", "")
        case Opcode.CHANNEL:
            item = Stray(offset, "channel", _parse(Channel, body).topic)
        case Opcode.MESSAGE:
            item = Stray(offset, "message", "")
        case _:
            raise _BadError(DamageKind.MALFORMED, f"a record of type {opcode} among the data")
    return item


def _parse(kind: type[_R], body: bytes) -> _R:
    try:
        return kind.read(_Body(BytesIO(body)))  # type: ignore[attr-defined, no-any-return]
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise _BadError(
            DamageKind.MALFORMED, f"unreadable {kind.__name__} record: {str(error) or type(error).__name__}"
        ) from error


def _attachment(body: bytes) -> Attachment:
    attachment = _parse(Attachment, body)
    (stored,) = struct.unpack("<I", body[-4:])
    if stored != _NOT_COMPUTED and stored != zlib.crc32(body[:-4]):
        raise _BadError(DamageKind.CHECKSUM, f"attachment {attachment.name!r}: its checksum does not match")
    return attachment


def _uncompress(chunk: Chunk, left: int = MAX_RECORD) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_RECORD:
        raise _BadError(DamageKind.OVERSIZE, f"a chunk claims {size} bytes uncompressed; at most {MAX_RECORD} are read")
    if size > left:
        raise _BadError(
            DamageKind.OVERSIZE,
            f"a chunk of {size} bytes uncompressed, more than a file of this size may unpack to: {MAX_RATIO} times "
            f"its size, and {MAX_UNPACKED} bytes",
        )
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            data = _zstd(chunk.data, size)
        case other:
            raise _BadError(DamageKind.MALFORMED, f"a chunk compressed by {other!r}; expected zstd")
    if len(data) != size:
        raise _BadError(DamageKind.MALFORMED, f"a chunk holds {len(data)} bytes uncompressed and claims {size}")
    if chunk.uncompressed_crc != _NOT_COMPUTED and zlib.crc32(data) != chunk.uncompressed_crc:
        raise _BadError(DamageKind.CHECKSUM, "the checksum of a chunk does not match")
    return data


def _zstd(data: bytes, size: int) -> bytes:
    try:
        # zstandard allocates the size that the frame claims: check it first.
        claimed = zstandard.get_frame_parameters(data).content_size
        if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise _BadError(
                DamageKind.MALFORMED, f"a chunk claims {size} bytes uncompressed, its compressed data {claimed}"
            )
        if size == 0:
            return b""
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise _BadError(DamageKind.CHECKSUM, f"the compressed data of a chunk are damaged: {error}") from error


def _check_message_index(body: bytes) -> None:
    if len(body) < _INDEX.size or len(body) - _INDEX.size < _INDEX.unpack_from(body)[1]:
        raise _BadError(DamageKind.MALFORMED, "a message index that is cut short")


def _check_data_end(body: bytes, data_crc: int | None) -> None:
    if len(body) < 4:
        raise _BadError(DamageKind.MALFORMED, f"an end-of-data record of {len(body)} bytes")
    stored = _parse(DataEnd, body).data_section_crc
    if data_crc is not None and stored not in (_NOT_COMPUTED, data_crc):
        raise _BadError(DamageKind.CHECKSUM, "the checksum over all data before it does not match")


def _check_footer(stream: BinaryIO, offset: int, size: int, body: bytes, summary_crc: int | None) -> None:
    if len(body) != 20:
        raise _BadError(DamageKind.MALFORMED, f"a footer of {len(body)} bytes")
    if summary_crc is None:
        raise _BadError(DamageKind.MALFORMED, "a footer before the end of the data")
    header = _FRAME.pack(Opcode.FOOTER, len(body))
    stored = _parse(Footer, body).summary_crc
    if stored != _NOT_COMPUTED and stored != zlib.crc32(body[:-_FOOTER_CRC], zlib.crc32(header, summary_crc)):
        raise _BadError(DamageKind.CHECKSUM, "the checksum of the summary does not match")
    tail = size - offset - _FRAME.size - len(body)
    magic = stream.read(len(MAGIC))
    if tail < len(MAGIC) and MAGIC.startswith(magic):
        raise _BadError(DamageKind.TRUNCATED, "the file ends inside its last bytes")
    if magic != MAGIC or tail > len(MAGIC):
        raise _BadError(DamageKind.MALFORMED, "something else than the end of the file follows the footer")


def _resume(stream: BinaryIO, offset: int, size: int) -> int | None:
    """Return the offset to resume at after an unreadable record: its end, or the next whole chunk, or None."""
    try:
        _, body = _frame(stream, offset, size)
    except _BadError:
        return _next_chunk(stream, offset + 1, size)
    following = offset + _FRAME.size + len(body)
    if following >= size or _framed(stream, following, size):
        return following if following < size else None
    return _next_chunk(stream, offset + 1, size)


def _framed(stream: BinaryIO, offset: int, size: int) -> bool:
    """Return whether a record of a known type may begin at ``offset``."""
    if offset + _FRAME.size > size:
        return False
    stream.seek(offset)
    opcode, length = _FRAME.unpack(stream.read(_FRAME.size))
    return opcode in Opcode.__members__.values() and length <= size - offset - _FRAME.size


def _next_chunk(stream: BinaryIO, offset: int, size: int) -> int | None:
    """Return the offset of the next chunk with a correct checksum, from ``offset`` on, or None."""
    window = 2**20
    candidates = 0
    position = offset
    while position < size and candidates < _MAX_CANDIDATES:
        stream.seek(position)
        block = stream.read(window + _CHUNK_TO_ZSTD + len(_ZSTD))
        found = block.find(_ZSTD)
        while 0 <= found < window + _CHUNK_TO_ZSTD and candidates < _MAX_CANDIDATES:
            start = position + found - _CHUNK_TO_ZSTD
            if start >= offset:
                candidates += 1
                if _whole_chunk(stream, start, size):
                    return start
            found = block.find(_ZSTD, found + 1)
        position += window
    return None


def _whole_chunk(stream: BinaryIO, offset: int, size: int) -> bool:
    try:
        opcode, body = _frame(stream, offset, size)
        if opcode == Opcode.CHUNK:
            unpack(body)
            return True
    except (_BadError, ValueError):
        return False
    return False
