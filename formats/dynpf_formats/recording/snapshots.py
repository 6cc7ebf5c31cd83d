"""Snapshots in a recording: data alone, which count only as far as they agree with the journal."""

from collections.abc import Iterator

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, Frozen, unpack
from dynpf_protocol.topics import NODES

from dynpf_formats.recording.findings import Finding, warning
from dynpf_formats.recording.reader import Recorded, Recording

__all__ = ["agreed", "check_snapshots", "decode_snapshot"]

_TOPIC = SNAPSHOT_PREFIX + NODES[0]  # those of all nodes are of one type


def decode_snapshot(payload: bytes) -> Snapshot:
    """Return the snapshot in a payload; raises BadMessageError."""
    snapshot = decode(_TOPIC, payload)
    assert isinstance(snapshot, Snapshot)
    return snapshot


def agreed(snapshot: Snapshot, entry: JournalEntry | None) -> Frozen:
    """Return what was frozen, by a snapshot whose step has the journal entry ``entry``.

    Raises BadMessageError if it cannot be read, or is not of the state and the chain value that the entry has.
    """
    where = f"the snapshot after step {snapshot.step}"
    if entry is None or (entry.step, entry.tick) != (snapshot.step, snapshot.tick):
        raise BadMessageError(f"{where} is of no step of the journal")
    frozen = unpack(snapshot.state)
    if entry.state and (entry.state, entry.chain) != (frozen.digest, snapshot.chain):
        raise BadMessageError(f"{where} is not of the state, or the chain value, that the journal has")
    return frozen


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
