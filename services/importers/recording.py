"""An imported log as a recording: its records as messages of node "log", its landmarks as an attachment."""

from collections import Counter
from pathlib import Path

import msgspec

from protocol.codec import encode
from protocol.envelope import Envelope
from protocol.topics import LOG_NODE
from services.importers.log import ImportedLog
from services.recording.header import Attachment, RunHeader
from services.recording.provenance import collect
from services.recording.writer import RecordingWriter

__all__ = ["BOOT", "LANDMARKS", "write_recording"]

BOOT = "import"
LANDMARKS = "landmarks.json"
"""The attachment that holds the log's landmarks, as a list of id, x and y."""


def write_recording(log: ImportedLog, path: Path) -> None:
    """Write ``log`` to ``path``; all times are the log's own. Raises RecordingError; an existing file is left alone."""
    origin = msgspec.json.encode({"import": log.summary}).decode()
    header = RunHeader(scenario=origin, seed=0, provenance=collect())
    landmarks = Attachment(name=LANDMARKS, media_type="application/json", data=msgspec.json.encode(log.landmarks))
    sequences: Counter[str] = Counter()
    with RecordingWriter(path, header, (landmarks,)) as writer:
        for topic, stamp_ns, message in log.records:
            envelope = Envelope(LOG_NODE, BOOT, sequences[topic], 0, stamp_ns, stamp_ns)
            sequences[topic] += 1
            writer.message(topic, envelope, encode(topic, message))
        writer.close(complete=True, reason="imported")
