"""Takes the end off the recording of a stopped run, with the tick that was made its last, so that the run can go on."""

from pathlib import Path

from dynpf_protocol.control import Outcome
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry

from dynpf_formats.recording.header import RunEnd
from dynpf_formats.recording.reader import Recorded, Recording, read_recording
from dynpf_formats.recording.writer import RecordingWriter

__all__ = ["is_stopped", "reopen"]

_GAP_TOPIC = "recorder/gap"


def is_stopped(end: RunEnd | None) -> bool:
    """Return whether a run ended because somebody stopped it, though its task and its time were not over."""
    return end is not None and end.complete and end.outcome == Outcome.STOPPED


def reopen(path: Path) -> None:
    """Leave of a stopped lockstep run what came before the tick that it was stopped at, without an end.

    The file is replaced in one step. Any other recording stays as it is. Raises RecordingError for what is none.
    """
    recording = read_recording(path, allow_truncated=True)
    if recording.truncated or not is_stopped(recording.end):
        return
    entries = [entry for node, boot in recording.journals() for entry in recording.journal(node, boot)]
    if not entries:
        return
    last = max(entry.tick for entry in entries)
    stamp_ns = min(entry.stamp_ns for entry in entries if entry.tick == last)
    writer = RecordingWriter(
        path,
        recording.header,
        recording.attachments,
        draft=path.with_name(f".{path.name}.draft"),
        boot="reopened",
        schemas=recording.schemas,
    )
    try:
        for record in recording.records:
            if record.topic != _GAP_TOPIC and _is_before(recording, record, last, stamp_ns):
                envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
                writer.message(record.topic, envelope, record.payload)
    except BaseException:
        writer.discard()  # the recording stays as it is
        raise
    writer.place(replace=True)
    writer.close(complete=False, reason="reopened, to go on")


def _is_before(recording: Recording, record: Recorded, last: int, stamp_ns: int) -> bool:
    """Return whether a record is of a tick before ``last``, whose stamp tells it where no journal entry does."""
    if record.topic.startswith(JOURNAL_PREFIX):
        return decode_entry(record.payload).tick < last
    tick = recording.tick_of(record)
    return record.stamp_ns < stamp_ns if tick is None else tick < last
