"""Recordings taken apart into records, and put together again with every checksum right."""

import zlib
from copy import copy
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import Any

import zstandard
from dynpf_formats.recording.mcap_records import MAGIC, Message, Region, contents, scan
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Metadata, Schema
from mcap.records import Message as MessageRecord

__all__ = ["Anatomy", "Cluster", "Item"]


@dataclass
class Cluster:
    """The records of a chunk, and how it is compressed."""

    records: list[McapRecord]
    compression: str = "zstd"
    tail: bytes = b""  # further records, as bytes


Item = Metadata | Attachment | Schema | Channel | MessageRecord | Cluster


@dataclass
class Anatomy:
    """A file as its parts; ``bytes`` writes them with checksums."""

    header: Header
    items: list[Item] = field(default_factory=list)
    summary: bool = True
    data_crc: bool = True  # else 0: not computed
    chunk_crc: bool = True

    @classmethod
    def of(cls, data: bytes) -> "Anatomy":
        """Take a sound file apart."""
        found = cls(Header("", ""))
        for item in scan(BytesIO(data[:]), len(data)) if data.startswith(MAGIC) else ():
            match item:
                case Header():
                    found.header = item
                case Metadata() | Attachment():
                    found.items.append(item)
                case Region(data=records):
                    found.items.append(Cluster([_record(records, record) for record in contents(records)]))
        return found

    def copy(self) -> "Anatomy":
        """Return a copy whose parts can be changed; payloads, which are immutable, are shared."""
        return replace(self, header=copy(self.header), items=[*map(_copied, self.items)])

    def clusters(self) -> list[Cluster]:
        """Return the chunks."""
        return [item for item in self.items if isinstance(item, Cluster)]

    def of_type(self, kind: type[Any]) -> list[Any]:
        """Return the records of a type, in chunks and outside."""
        inside = [record for cluster in self.clusters() for record in cluster.records]
        return [record for record in (*self.items, *inside) if isinstance(record, kind)]

    def metadata(self, name: str) -> Metadata | None:
        """Return the metadata record with a name."""
        return next((item for item in self.items if isinstance(item, Metadata) and item.name == name), None)

    def bytes(self) -> bytes:
        """Return the file."""
        data = bytearray(MAGIC + _written(self.header))
        for item in self.items:
            data += _chunk(item, self.chunk_crc) if isinstance(item, Cluster) else _written(item)
        data += _written(DataEnd(zlib.crc32(data) if self.data_crc else 0))
        start = len(data)
        if self.summary:
            known = {(type(record), record.id): record for kind in (Schema, Channel) for record in self.of_type(kind)}
            data += b"".join(map(_written, known.values()))
        beginning = start if len(data) > start else 0
        footer = _written(Footer(beginning, 0, 0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(data[start:]))
        return bytes(data) + footer[:-4] + crc.to_bytes(4, "little") + MAGIC


def _copied(item: Any) -> Any:
    match item:
        case Cluster():
            return replace(item, records=[*map(_copied, item.records)])
        case Metadata() | Channel():
            return replace(item, metadata=dict(item.metadata))
    return copy(item)


def _record(data: bytes, record: Message | Schema | Channel) -> McapRecord:
    if not isinstance(record, Message):
        return record
    payload = data[record.start : record.stop]
    return MessageRecord(record.channel_id, record.log_time, payload, record.publish_time, record.sequence)


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _chunk(cluster: Cluster, with_crc: bool) -> bytes:
    data = b"".join(map(_written, cluster.records)) + cluster.tail
    times = [record.log_time for record in cluster.records if isinstance(record, MessageRecord)] or [0]
    packed = zstandard.compress(data, 1) if cluster.compression == "zstd" else data
    return _written(
        Chunk(
            compression=cluster.compression,
            data=packed,
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(data) if with_crc else 0,
            uncompressed_size=len(data),
        )
    )
