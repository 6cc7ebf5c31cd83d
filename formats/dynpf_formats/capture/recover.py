"""Mends a capture that was cut off or damaged: what is whole goes into a new file, with an end that says what it is."""

from pathlib import Path

from mcap.writer import Writer

from dynpf_formats.capture.form import CAPTURE, END, PROFILE, Began, Ended, as_text
from dynpf_formats.capture.reader import Capture, Found, found_in, read_capture
from dynpf_formats.capture.writer import CHUNK_BYTES
from dynpf_formats.recording.files import PlainFile, already_there, unwritable
from dynpf_formats.recording.recover import Recovery

__all__ = ["recover_capture"]


def recover_capture(source: Path, target: Path) -> Recovery:
    """Write everything readable of a capture into the new file ``target`` and return what was kept and is missing.

    Raises RecordingExistsError if ``target`` exists, RecordingError if there is nothing to recover.
    """
    capture = read_capture(source)
    end = _end_of(capture)
    try:
        file = PlainFile(target, overwrite=False)
    except FileExistsError:
        raise already_there(target) from None
    except OSError as error:
        raise unwritable(target, error) from error
    try:
        _copy(source, capture.began, end, Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True))  # type: ignore[arg-type]
    except OSError as error:
        raise unwritable(target, error) from error
    finally:
        file.close()
    return Recovery(
        kept=capture.tally.messages,
        last_stamp_ns=max((topic.last_ns for topic in capture.tally.topics.values()), default=0),
        missing=capture.tally.missing,
        refused=0,
        damage=tuple(f"{found.text} (at byte {found.offset})" for found in capture.damage),
        complete=end.complete,
        reason=end.reason,
    )


def _end_of(capture: Capture) -> Ended:
    ended, tally = capture.ended, capture.tally
    if ended is not None and not capture.damage:
        return ended
    reason = f"recovered: {capture.damage[0].text}" if capture.damage else "recovered: the end was never written"
    last_ns = max((topic.last_ns for topic in tally.topics.values()), default=capture.began.began_ns)
    return tally.ended(reason, last_ns, complete=False)


def _copy(source: Path, began: Began, end: Ended, writer: Writer) -> None:
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    writer.start(PROFILE, f"dynpf {began.dynpf_version}")
    writer.add_metadata(CAPTURE, as_text(began))
    for found in found_in(source):
        if not isinstance(found, Found):
            continue
        channel, schema = found.channel, found.schema
        if channel.id not in channels:
            if channel.schema_id not in schemas:
                schemas[channel.schema_id] = (
                    0 if schema is None else writer.register_schema(schema.name, schema.encoding, schema.data)
                )
            number = schemas[channel.schema_id]
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        writer.add_message(channels[channel.id], found.log_ns, found.payload, found.publish_ns, found.sequence)
    writer.flush()  # type: ignore[no-untyped-call]
    writer.add_metadata(END, as_text(end))
    writer.finish()  # type: ignore[no-untyped-call]
