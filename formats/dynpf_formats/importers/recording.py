"""Writes imported logs as recordings: records as messages of node "log", landmarks and maps as attachments."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from dynpf_protocol.codec import encode
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.topics import LOG_NODE

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, ImportSummary
from dynpf_formats.recording.header import RunHeader
from dynpf_formats.recording.provenance import collect
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.regular_files import readable

__all__ = ["BOOT", "write_recording"]

BOOT = "import"
TRUTH = "log/truth"


def write_recording(log: ImportedLog, path: Path) -> ImportSummary:
    """Write ``log`` to ``path`` record by record and return its summary; all times are the log's own.

    Raises RecordingError, leaving an existing file alone, and whatever reading the records raises; then the new file
    is removed.
    """
    text = msgspec.json.encode(
        {"import": {"source": readable(log.source), "format": log.format, "settings": log.settings}}
    )
    header = RunHeader(scenario=text.decode(), seed=0, provenance=collect())
    counts: Counter[str] = Counter()
    spans: dict[bool, tuple[int, int]] = {}  # of references, and of all else
    with RecordingWriter(path, header, log.attachments) as writer:
        try:
            for topic, stamp_ns, message in log.records:
                envelope = Envelope(LOG_NODE, BOOT, counts[topic], 0, stamp_ns, stamp_ns)
                counts[topic] += 1
                is_truth = topic.endswith(TRUTH)
                first, last = spans.get(is_truth, (stamp_ns, stamp_ns))
                spans[is_truth] = min(first, stamp_ns), max(last, stamp_ns)
                writer.message(topic, envelope, _payload(topic, stamp_ns, message))
        except BaseException:
            writer.close(complete=False, reason="the import failed")
            path.unlink()
            raise
        writer.close(complete=True, reason="imported")
    start = min((first for first, _ in spans.values()), default=0)
    end = max((last for _, last in spans.values()), default=0)
    return ImportSummary(
        source=readable(log.source),
        format=log.format,
        settings=log.settings,
        start_ns=start,
        duration_s=(end - start) / 1e9,
        messages=dict(sorted(counts.items())),
        attachments=tuple(attachment.name for attachment in log.attachments),
        dropped=log.losses.summary(),
        warnings=tuple(_apart(spans)),
    )


def _apart(spans: Mapping[bool, tuple[int, int]]) -> Iterator[str]:
    """Yield a warning if no record of a log was taken while there were references, in words."""
    if len(spans) < 2:
        return
    (truth_first, truth_last), (first, last) = spans[True], spans[False]
    hint = "nothing can be scored (are both clocks the same, and the stamps in seconds?)"
    if truth_last < first:
        yield f"the reference ends {(first - truth_last) / 1e9:.1f} s before the log begins: {hint}"
    elif truth_first > last:
        yield f"the reference begins {(truth_first - last) / 1e9:.1f} s after the log ends: {hint}"


def _payload(topic: str, stamp_ns: int, message: Any) -> bytes:
    try:
        return encode(topic, message)
    except BadMessageError as error:  # a number that importers let through: the log is wrong
        raise ImportFailedError(f"record at {stamp_ns * 1e-9:.3f} s: {error}") from error
