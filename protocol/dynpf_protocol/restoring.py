"""Restoring: snapshots as they are read again: data alone, which count only as far as they agree with the journal."""

from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import Snapshot
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX, Frozen, unpack
from dynpf_protocol.topics import NODES

__all__ = ["agreed", "decode_snapshot"]

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
