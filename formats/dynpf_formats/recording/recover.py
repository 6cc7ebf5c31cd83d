"""Recovers a damaged recording into a new file: everything readable, with an end that says what was lost."""

from pathlib import Path

import msgspec
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import ProtocolError

from dynpf_formats.recording.doctor import altered
from dynpf_formats.recording.errors import RecordingExistsError
from dynpf_formats.recording.mcap_records import Damage
from dynpf_formats.recording.reader import Recorded, Recording, load
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.regular_files import exists

__all__ = ["Recovery", "recover"]

_GAP_TOPIC = "recorder/gap"


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """What was kept and lost.

    ``missing`` counts messages known to be missing, ``refused`` those that break the protocol and cannot be written.
    """

    kept: int
    last_stamp_ns: int
    missing: int
    refused: int
    damage: tuple[str, ...]
    complete: bool
    reason: str


def recover(source: Path | str, target: Path | str) -> Recovery:
    """Write everything readable of ``source`` into the new recording ``target`` and return what was kept and lost.

    Damaged chunks and repetitions are left out, intact ones after them kept. The result is marked incomplete unless
    nothing was wrong.
    Raises RecordingExistsError if ``target`` exists, RecordingError if there is nothing to recover.
    """
    if exists(Path(target)):
        raise RecordingExistsError(f"{target}: the file exists; choose another name")
    recording, damage = load(source)
    complete, reason = _verdict(recording, damage)
    outcome = recording.end.outcome if complete and recording.end is not None else ""
    refused = 0
    repeated = {again.position for first, again in recording.repetitions() if _equal(first, again)}
    with RecordingWriter(
        target, recording.header, recording.attachments, boot="recovered", schemas=recording.schemas
    ) as writer:
        for record in recording.records:
            if record.position in repeated:
                continue
            if record.topic == _GAP_TOPIC:
                continue  # the writer finds these gaps again, together with those that the damage made
            try:
                # Recordings keep the tick in the journal alone, so the envelope's has no meaning here.
                envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
                writer.message(record.topic, envelope, record.payload)
            except ProtocolError:
                refused += 1
        end = writer.close(complete=complete, reason=reason, outcome=outcome)
    return Recovery(
        kept=sum(end.counts.values()) - end.counts.get(_GAP_TOPIC, 0),
        last_stamp_ns=max((record.stamp_ns for record in recording.records), default=0),
        missing=end.missing,
        refused=refused,
        damage=tuple(f"{found.text} (at byte {found.offset})" for found in damage),
        complete=end.complete,
        reason=end.reason,
    )


def _equal(first: Recorded, again: Recorded) -> bool:
    return first.stamp_ns == again.stamp_ns and first.payload == again.payload


def _verdict(recording: Recording, damage: tuple[Damage, ...]) -> tuple[bool, str]:
    if damage:
        return False, f"recovered: {damage[0].text} (at byte {damage[0].offset})"
    if recording.end is None:
        return False, "recovered: the end of the run was never written"
    if found := altered(recording):
        return False, f"recovered: {found[0].where}: {found[0].what}"
    return recording.end.complete, recording.end.reason
