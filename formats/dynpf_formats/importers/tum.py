"""Importer of trajectories in the format of the TUM RGB-D benchmark, which evo writes too: reference poses.

A line is a pose: time (s), x, y, z (m), and the quaternion x, y, z, w; text after # is a comment. Only the pose in the
plane is kept: x, y and heading.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.json_text import read_json
from dynpf_protocol.messages import RobotState
from dynpf_protocol.topics import LOG_NODE

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.text import finite_number, lines_of, seconds_to_ns
from dynpf_formats.importers.transforms import matrix, planar
from dynpf_formats.recording.reader import Recording, read_recording

__all__ = ["import_tum"]

COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
TRUTH = "log/truth"


class _Import(msgspec.Struct):
    settings: dict[str, Any]


class _Imported(msgspec.Struct, rename={"import_": "import"}):
    """What the scenario of an imported log says."""

    import_: _Import


class _Vector(NamedTuple):
    x: float
    y: float
    z: float
    w: float = 0.0


def import_tum(path: Path, log: Path | None = None) -> ImportedLog:
    """Return the poses as a log of references, or, given an imported ``log``, that log with them as its reference.

    Unreadable lines, and poses earlier than the previous one, are left out and counted. Raises ImportFailedError for a
    file without poses, RecordingError for a log that cannot be read.
    """
    losses = Losses()
    if next(_poses(path, losses), None) is None:
        first = next((dropped.first for dropped in losses.summary().values()), f"{path.name}: no line")
        raise ImportFailedError(f"{path}: no pose can be read: {first}; expected time (s), x, y, z, qx, qy, qz, qw")
    losses = Losses()
    truth = _poses(path, losses)
    if log is None:
        return ImportedLog(path.name, "tum", {}, truth, losses)
    recording = read_recording(log)
    kept = [record for record in recording.messages(node=LOG_NODE) if record.topic != TRUTH]
    if not kept:
        raise ImportFailedError(f"{log}: holds no records of an imported log to which a reference could be given")
    records = (Record(record.topic, record.stamp_ns, decode(record.topic, record.payload)) for record in kept)
    settings = {**_settings(recording), "log": log.name}
    return ImportedLog(path.name, "tum", settings, _merged(truth, records), losses, recording.attachments)


def _settings(recording: Recording) -> Mapping[str, Any]:
    """Return how the log was imported, such as the range of its scanner; empty for the log of a run."""
    try:
        return read_json(recording.header.scenario, _Imported).import_.settings
    except msgspec.DecodeError:
        return {}


def _poses(path: Path, losses: Losses) -> Iterator[Record]:
    newest_ns = 0
    for number, line in lines_of(path):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        where = f"{path.name}:{number}"
        try:
            stamp_ns, pose = _pose(fields)
        except ValueError as error:
            losses.add("lines that cannot be read", f"{where}: {error}")
            continue
        if stamp_ns < newest_ns:
            losses.add("poses whose clock went backwards", f"{where}: {fields[0]} s")
            continue
        newest_ns = stamp_ns
        yield Record(TRUTH, stamp_ns, pose)


def _pose(fields: list[str]) -> tuple[int, RobotState]:
    if len(fields) != len(COLUMNS):
        raise ValueError(f"{len(fields)} columns; expected {len(COLUMNS)}")
    stamp_ns = seconds_to_ns(fields[0])
    x, y, z, *q = (finite_number(text, name) for text, name in zip(fields[1:], COLUMNS[1:], strict=True))
    found = matrix(_Vector(x, y, z), _Vector(*q))
    if found is None:
        raise ValueError(f"quaternion is {' '.join(fields[4:])}; expected one of length 1")
    x, y, theta = planar(found)
    return stamp_ns, RobotState(x=x, y=y, theta=theta)


def _merged(truth: Iterator[Record], others: Iterator[Record]) -> Iterator[Record]:
    """Yield the other records in their order, each after the poses up to its time."""
    waiting = next(truth, None)
    for record in others:
        while waiting is not None and waiting.stamp_ns <= record.stamp_ns:
            yield waiting
            waiting = next(truth, None)
        yield record
    if waiting is not None:
        yield waiting
    yield from truth
