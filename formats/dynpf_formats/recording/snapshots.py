"""Snapshots in a recording: whether they agree with its journal."""

from collections.abc import Iterator

import msgspec
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.restoring import agreed, decode_snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX

from dynpf_formats.recording.findings import Finding, warning
from dynpf_formats.recording.reader import Recorded, Recording

__all__ = ["check_snapshots"]


def check_snapshots(recording: Recording) -> Iterator[Finding]:
    """Yield the snapshots that do not agree with the journal; nothing goes on from those."""
    for record in recording.messages():
        if record.topic == SNAPSHOT_PREFIX + record.node:
            try:
                snapshot = decode_snapshot(record.payload)
                agreed(snapshot, _entry(recording, record, snapshot.step))
            except BadMessageError as bad:
                yield warning(f"{bad}; it is not used", record.topic)


def _entry(recording: Recording, record: Recorded, step: int) -> JournalEntry | None:
    found = recording.find(record.node, record.boot, JOURNAL_PREFIX + record.node, step)
    try:
        return None if found is None else decode_entry(found.payload)
    except msgspec.DecodeError:
        return None
