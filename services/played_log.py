"""The log that a run plays: an imported recording, or what a recorded run had played of one."""

import json
from pathlib import Path

from protocol.codec import decode
from protocol.messages import RobotState
from protocol.topics import LOG_NODE, topic
from services.errors import UsageError
from services.recording.digest import content_digest
from services.recording.reader import Recording, read_recording
from services.scenario import LogFacts
from services.source import LogRecord

__all__ = ["PlayedLog", "log_records"]

LANDMARKS = "landmarks.json"


class PlayedLog:
    """The records of an imported log, what they bring to a scenario, and what is attached to it.

    Raises RecordingError for a file that cannot be read, UsageError for one that is no imported log.
    """

    def __init__(self, path: Path) -> None:
        recording = read_recording(path)
        self.path = path
        self.records = log_records(recording)
        if not any(topic(one.topic).triggers for one in self.records):
            raise UsageError(f"{path}: holds no sensor records of an imported log; dynpf import makes such a recording")
        self.attachments = recording.attachments
        found = [one.data for one in recording.attachments if one.name == LANDMARKS]
        reference = next((decode("log/truth", one.payload) for one in self.records if one.topic == "log/truth"), None)
        start = (reference.x, reference.y, reference.theta) if isinstance(reference, RobotState) else None
        self.facts = LogFacts(content_digest(recording), json.loads(found[0]) if found else [], start)


def log_records(recording: Recording) -> list[LogRecord]:
    """Return the records of an imported log, or those that a run of one played, in file order."""
    return [LogRecord(one.topic, one.stamp_ns, one.payload) for one in recording.messages() if one.node == LOG_NODE]
