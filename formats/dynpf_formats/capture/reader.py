"""Reads a capture: one pass over the file checks every byte, and makes the tally again from the messages in it."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec
from dynpf_protocol.json_text import read_json
from mcap.records import Channel, Header, Metadata, Schema

from dynpf_formats.capture.form import CAPTURE, DROPPED, END, PROFILE, Began, Dropped, Ended, Origin, read
from dynpf_formats.capture.tally import Tally
from dynpf_formats.recording.errors import CorruptRecordingError, RecordingError
from dynpf_formats.recording.mcap_records import MAGIC, Damage, DamageKind, End, Message, Region, Stray, contents, scan
from dynpf_formats.recording.summary import read_summary
from dynpf_formats.regular_files import open_regular

__all__ = ["Capture", "Found", "found_in", "is_capture", "read_capture"]

_MOST_DAMAGE = 1000
_MOST_CHANNELS = 2**16
_HEAD = 2**16  # bytes in which header and first metadata lie

_UNKNOWN = Began(dynpf_version="unknown", connect="unknown", keys=(), domain=0, format="unknown", began_ns=0)


class Capture(NamedTuple):
    """What is in a capture. ``truncated``: its footer was never written."""

    path: Path
    began: Began
    ended: Ended | None
    tally: Tally
    damage: tuple[Damage, ...]
    truncated: bool


class Found(NamedTuple):
    """A message of a capture: its channel and schema (None for none), numbers, times in ns, and bytes."""

    channel: Channel
    schema: Schema | None
    sequence: int
    log_ns: int
    publish_ns: int
    payload: bytes


def is_capture(path: Path) -> bool:
    """Return whether a file begins as a capture does; False for one that cannot be read."""
    try:
        with open_regular(path) as file:
            if file.read(len(MAGIC)) != MAGIC:
                return False
            size = min(os.fstat(file.fileno()).st_size, _HEAD)
            records = scan(file, size)
            header, metadata = next(records, None), next(records, None)
    except (OSError, ValueError):
        return False
    is_ours = isinstance(metadata, Metadata) and metadata.name == CAPTURE
    return isinstance(header, Header) and header.profile == PROFILE and is_ours


def read_capture(path: Path) -> Capture:
    """Return what is in a capture as far as it can be read; raises RecordingError if nothing can."""
    began, ended, tally, truncated = _UNKNOWN, None, Tally(), True
    damage: list[Damage] = []
    origins: dict[int, Origin | None] = {}
    for item in found_in(path):
        match item:
            case Began():
                began = item
            case Ended():
                ended = item
            case Damage():
                damage.append(item)
                if len(damage) > _MOST_DAMAGE:
                    raise CorruptRecordingError(f"{path}: damaged in more than {_MOST_DAMAGE} places")
            case End():
                truncated = False
            case Found():
                _count(tally, origins, item)
    if ended is not None:
        tally.outages += ended.outages
    return Capture(path, began, ended, tally, tuple(damage), truncated)


def _count(tally: Tally, origins: dict[int, Origin | None], found: Found) -> None:
    channel = found.channel
    if channel.topic == DROPPED and not channel.metadata:  # else a key of that name
        try:
            tally.drop(read_json(found.payload, Dropped))
        except msgspec.DecodeError:
            return  # the chunk is whole, so no recorder of ours has written it
        return
    if channel.id not in origins:
        origins[channel.id] = Origin.of(channel.topic, channel.metadata)
    if (origin := origins[channel.id]) is not None:
        tally.add(origin, found.sequence, found.publish_ns, found.log_ns, len(found.payload))


def found_in(path: Path) -> Iterator[Began | Ended | Found | Damage | End]:
    """Yield what can be read of a capture, in the order of the file, and the damage; raises RecordingError."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            schemas, channels = _described(file, size)
            yield from _items(scan(file, size), schemas, channels)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from error


def _described(file: BinaryIO, size: int) -> tuple[dict[int, Schema], dict[int, Channel]]:
    """Return the schemas and channels of the summary, if there is one: a damaged chunk may have described them, too."""
    try:
        summary = read_summary(file, size)
    except ValueError:
        return {}, {}
    schemas, channels = summary.schemas[:_MOST_CHANNELS], summary.channels[:_MOST_CHANNELS]
    return {schema.id: schema for schema in schemas}, {channel.id: channel for channel in channels}


def _items(
    records: Iterator[object], schemas: dict[int, Schema], channels: dict[int, Channel]
) -> Iterator[Began | Ended | Found | Damage | End]:
    for record in records:
        match record:
            case Metadata(name=name, metadata=entries) if name in (CAPTURE, END):
                said = read(entries, Began) if name == CAPTURE else read(entries, Ended)
                yield (
                    Damage(DamageKind.CHECKSUM, 0, f"the metadata {name!r} do not match their checksum")
                    if said is None
                    else said
                )
            case Region():
                yield from _messages(record, schemas, channels)
            case Stray():
                yield Damage(DamageKind.MALFORMED, record.offset, f"a {record.what} outside a chunk")
            case Damage() | End():
                yield record


def _messages(region: Region, schemas: dict[int, Schema], channels: dict[int, Channel]) -> Iterator[Found | Damage]:
    nameless = 0
    try:
        for record in contents(region.data):
            match record:
                case Schema() if len(schemas) < _MOST_CHANNELS:
                    schemas.setdefault(record.id, record)
                case Channel() if len(channels) < _MOST_CHANNELS:
                    channels.setdefault(record.id, record)
                case Message(number, sequence, log_ns, publish_ns, start, stop):
                    if (channel := channels.get(number)) is None:
                        nameless += 1
                    else:
                        payload = region.data[start:stop]
                        yield Found(channel, schemas.get(channel.schema_id), sequence, log_ns, publish_ns, payload)
    except ValueError as error:
        yield Damage(DamageKind.MALFORMED, region.offset, f"chunk: {error}")
    if nameless:
        text = f"{nameless} messages of a chunk are on channels that were described in a damaged one"
        yield Damage(DamageKind.MALFORMED, region.offset, text)
