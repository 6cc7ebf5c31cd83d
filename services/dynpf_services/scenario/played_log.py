"""What comes into a run from outside: the log that it plays, imported or of a recorded run, and a person's acts."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from dynpf_formats.recording.attachments import LANDMARKS, files_of
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.json_text import read_json
from dynpf_protocol.messages import OdometryPose, RobotState
from dynpf_protocol.topics import LOG_NODE, is_act, topic
from dynpf_runtime.source import LogRecord

from dynpf.se2 import compose, relative
from dynpf_services.scenario.schema import LogFacts

__all__ = ["PlayedLog", "acts_of", "log_records", "start_by"]


class PlayedLog:
    """The records of an imported log, its facts for a scenario, and its attachments.

    Raises RecordingError for a file that cannot be read, UsageError if it is no imported log.
    """

    def __init__(self, path: Path) -> None:
        recording = read_recording(path)
        self.path = path
        self.records = log_records(recording)
        if not any(topic(record.topic).wakes for record in self.records):
            raise UsageError(f"{path}: holds no sensor records of an imported log; dynpf import makes such a recording")
        self.attachments = recording.attachments
        landmarks = [attachment.data for attachment in recording.attachments if attachment.name == LANDMARKS]
        self.facts = LogFacts(
            digest=content_digest(recording),
            landmarks=_landmarks(path, landmarks[0]) if landmarks else [],
            starts=_starts(self.records),
            files=files_of(recording.attachments),
            topics=frozenset(record.topic for record in self.records),
        )


def log_records(recording: Recording) -> list[LogRecord]:
    """Return the records of an imported log, or those in the recording of a run that played one, in file order."""
    return [
        LogRecord(record.topic, record.stamp_ns, record.payload)
        for record in recording.messages()
        if record.node == LOG_NODE
    ]


def acts_of(recording: Recording) -> dict[int, list[LogRecord]]:
    """Return what a person did in a recorded run, by tick."""
    if not any(is_act(source.topic) for source in recording.sources):
        return {}
    found: dict[int, list[LogRecord]] = {}
    for node, boot in recording.journals():
        for entry in recording.journal(node, boot):
            for made in entry.hosted:
                record = recording.find(made.node, boot, made.topic, made.sequence) if is_act(made.topic) else None
                if record is not None:
                    found.setdefault(entry.tick, []).append(LogRecord(made.topic, record.stamp_ns, record.payload))
    return found


def _starts(records: list[LogRecord]) -> dict[str, tuple[float, float, float]]:
    """Return each robot's pose at its first record, by name; "" for a robot without a name."""
    robots = sorted({record.topic.rpartition("log/")[0].removesuffix("/") for record in records})
    return {robot: pose for robot in robots if (pose := start_by(records, robot, "log/truth")) is not None}


def start_by(records: list[LogRecord], robot: str, poses: str) -> tuple[float, float, float] | None:
    """Return a robot's pose at its first record: the first of ``poses`` minus the odometry's motion until then."""
    first = last = None
    topics = {f"{robot}/{name}".removeprefix("/") for name in ("log/odometry_pose", poses)}
    for record in records:
        if record.topic not in topics:
            continue
        match decode(record.topic, record.payload):
            case OdometryPose(x=x, y=y, theta=theta):
                last = np.array([x, y, theta])
                first = last if first is None else first
            case RobotState(x=x, y=y, theta=theta):
                if first is None or last is None:
                    return x, y, theta
                x, y, theta = compose(np.array([x, y, theta]), relative(last, first)).tolist()
                return x, y, theta
    return None


def _landmarks(path: Path, data: bytes) -> list[dict[str, Any]]:
    try:
        return read_json(data, list[dict[str, Any]])
    except msgspec.DecodeError as error:
        raise UsageError(f"{path}: {LANDMARKS}: {error}; expected a list of id, x and y") from error
