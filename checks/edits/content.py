"""A recording taken apart, to be changed and written again with all of MCAP's checksums right."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_formats.recording import sealed
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.header import PROFILE, RUN, RUN_END, Attachment, RunEnd, RunHeader, as_entries, seal_of
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.stream import RecordedSchema, Source
from dynpf_protocol.journal import JournalEntry, chain_after, encode_entry, genesis
from mcap.writer import Writer

__all__ = ["Content", "Row", "entry_of", "read_content", "replaced", "resealed", "with_seal", "write_content"]


class Row(NamedTuple):
    """One message or journal entry."""

    topic: str
    node: str
    boot: str
    sequence: int
    stamp_ns: int
    publish_ns: int
    payload: bytes

    @property
    def source(self) -> Source:
        """Topic and sender."""
        return Source(self.topic, self.node, self.boot)


class Content(NamedTuple):
    """Everything in a recording; ``rows`` are in the order of the file."""

    header: RunHeader
    attachments: tuple[Attachment, ...]
    rows: tuple[Row, ...]
    end: RunEnd
    schemas: Mapping[str, RecordedSchema]
    foreign: tuple[tuple[str, dict[str, str]], ...] = ()  # further metadata records, by name


def read_content(path: Path) -> Content:
    """Return what is in a recording; raises RecordingError if it is damaged, or has no end."""
    recording = read_recording(path)
    if recording.end is None:
        raise RecordingError(f"{path}: the end of the run was never written")
    rows = tuple(Row(*one.source, one.sequence, one.stamp_ns, one.publish_ns, one.payload) for one in recording.records)
    return Content(recording.header, recording.attachments, rows, recording.end, recording.schemas)


def write_content(content: Content, path: Path) -> None:
    """Write a recording; its end is written as it is, with the checksum of its entries."""
    with path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(PROFILE)
        writer.add_metadata(RUN, as_entries(content.header))
        for name, entries in content.foreign:
            writer.add_metadata(name, entries)
        for item in content.attachments:
            writer.add_attachment(0, 0, item.name, item.media_type, item.data)
        schemas: dict[RecordedSchema, int] = {}
        channels: dict[Source, int] = {}
        for row in content.rows:
            if row.source not in channels:
                described = _schema(content, row.topic)
                if described not in schemas:
                    schemas[described] = writer.register_schema(described.name, "jsonschema", described.data)
                sender = {"node": row.node, "boot": row.boot}
                channels[row.source] = writer.register_channel(row.topic, "json", schemas[described], sender)
            writer.add_message(channels[row.source], row.stamp_ns, row.payload, row.publish_ns, row.sequence)
        writer.flush()  # type: ignore[no-untyped-call]
        writer.add_metadata(RUN_END, as_entries(content.end))
        writer.finish()  # type: ignore[no-untyped-call]


def entry_of(row: Row) -> JournalEntry | None:
    """Return the journal entry in a row, or None if it is a message, or no entry."""
    return sealed.entry_of(row.topic, row.payload)


def resealed(content: Content) -> Content:
    """Return the content with chain values and seal computed anew, as somebody would who knows how."""
    rows = _chained(content)
    schemas = {row.topic: _schema(content, row.topic) for row in rows}
    filed = ((row.source, row.sequence, row.stamp_ns, row.publish_ns, row.payload) for row in rows)
    end = sealed.end_of(content.header, content.attachments, filed, schemas, content.end)
    return content._replace(rows=rows, end=end)


def with_seal(content: Content) -> Content:
    """Return the content with the seal of what its end says, true or not."""
    return content._replace(end=msgspec.structs.replace(content.end, seal=seal_of(content.end)))


def _chained(content: Content) -> tuple[Row, ...]:
    known = {(*row.source, row.sequence): row for row in reversed(content.rows)}
    chains: dict[str, bytes] = {}
    links: dict[int, Row] = {}
    entries = [(index, row, entry) for index, row in enumerate(content.rows) if (entry := entry_of(row)) is not None]
    seen: set[tuple[Source, int]] = set()
    for index, row, entry in sorted(entries, key=lambda item: item[1].sequence):
        if (row.source, row.sequence) in seen:
            continue  # readers take the first of entries with the same number
        seen.add((row.source, row.sequence))
        made = [(one.topic, one.node, row.boot, one.sequence) for one in entry.hosted]
        made += [(one.topic, row.node, row.boot, one.sequence) for one in entry.produced]
        messages = [(known[key].stamp_ns, known[key].payload) for key in made if key in known]
        previous = chains.get(row.node) or genesis(row.node, content.header.scenario)
        chain = chains[row.node] = chain_after(previous, row.boot, entry, messages)
        changed = msgspec.structs.replace(entry, chain=chain.hex() if entry.state else "")
        links[index] = row._replace(payload=encode_entry(changed))
    return tuple(links.get(index, row) for index, row in enumerate(content.rows))


def _schema(content: Content, topic: str) -> RecordedSchema:
    return content.schemas.get(topic, RecordedSchema("unknown", b"{}"))


def replaced(rows: Sequence[Row], index: int, *new: Row) -> tuple[Row, ...]:
    """Return the rows with others in the place of one of them."""
    return (*rows[:index], *new, *rows[index + 1 :])
