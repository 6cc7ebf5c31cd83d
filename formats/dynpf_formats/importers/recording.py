"""Writes imported logs as recordings: records as messages of node "log", landmarks and maps as attachments."""

import heapq
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.topics import LOG_NODE

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Record
from dynpf_formats.importers.stream import LogStream, StreamSummary
from dynpf_formats.recording.header import Attachment, RunHeader
from dynpf_formats.recording.provenance import collect
from dynpf_formats.recording.writer import RecordingWriter

__all__ = ["BOOT", "LANDMARKS", "write_recording", "write_stream", "write_team"]

BOOT = "import"
LANDMARKS = "landmarks.json"
"""The attachment that holds the log's landmarks, as a list of id, x and y."""


def write_team(logs: Sequence[ImportedLog], path: Path) -> None:
    """Write the logs of robots that share clock and map into one recording, in order of time."""
    landmarks = Attachment(name=LANDMARKS, media_type="application/json", data=msgspec.json.encode(logs[0].landmarks))
    records = heapq.merge(*(log.records for log in logs), key=lambda record: record.stamp_ns)
    origin = {"robots": [msgspec.to_builtins(log.summary) for log in logs]}
    _write(records, path, origin, (landmarks,))


class _Written(NamedTuple):
    counts: Counter[str]  # topic -> messages
    first_ns: int
    last_ns: int


def write_recording(log: ImportedLog, path: Path) -> None:
    """Write ``log`` to ``path``; all times are the log's own. Raises RecordingError; an existing file is left alone."""
    landmarks = Attachment(name=LANDMARKS, media_type="application/json", data=msgspec.json.encode(log.landmarks))
    _write(log.records, path, msgspec.to_builtins(log.summary), (landmarks,))


def write_stream(log: LogStream, path: Path) -> StreamSummary:
    """Write ``log`` to ``path`` record by record and return its summary; all times are the log's own.

    Raises RecordingError, leaving an existing file alone, and whatever reading the records raises; then the new file
    is removed.
    """
    origin = {"source": log.source, "format": log.format, "settings": dict(log.settings)}
    written = _write(log.records, path, origin, log.attachments)
    return StreamSummary(
        source=log.source,
        format=log.format,
        settings=log.settings,
        start_ns=written.first_ns,
        duration_s=(written.last_ns - written.first_ns) / 1e9,
        messages=dict(sorted(written.counts.items())),
        attachments=tuple(attachment.name for attachment in log.attachments),
        dropped=log.losses.summary(),
    )


def _write(
    records: Iterable[Record], path: Path, origin: Mapping[str, Any], attachments: tuple[Attachment, ...]
) -> _Written:
    text = msgspec.json.encode({"import": origin}).decode()
    header = RunHeader(scenario=text, seed=0, provenance=collect())
    sequences: Counter[str] = Counter()
    first, last = 2**63, 0
    with RecordingWriter(path, header, attachments) as writer:
        try:
            for topic, stamp_ns, message in records:
                envelope = Envelope(LOG_NODE, BOOT, sequences[topic], 0, stamp_ns, stamp_ns)
                sequences[topic] += 1
                first, last = min(first, stamp_ns), max(last, stamp_ns)
                writer.message(topic, envelope, _payload(topic, stamp_ns, message))
        except BaseException:
            writer.close(complete=False, reason="the import failed")
            path.unlink()
            raise
        writer.close(complete=True, reason="imported")
    return _Written(sequences, min(first, last), last)


def _payload(topic: str, stamp_ns: int, message: Any) -> bytes:
    try:
        return encode(topic, message)
    except BadMessageError as error:  # a number that importers let through: the log is wrong
        raise ImportFailedError(f"record at {stamp_ns * 1e-9:.3f} s: {error}") from error
