"""Importer of UTIAS MRCLAM logs (Leung et al., IJRR 30(8), 2011): odometry, range and bearing, motion-capture poses.

A data set is a folder of text tables: Barcodes, Landmark_Groundtruth, and for each robot Odometry, Measurement and
Groundtruth, named ``Robot1_Odometry.dat`` and so on; or of a single robot, under any other prefix or none. Each may
be compressed, as ``.dat.xz``. A measurement names a barcode, which the table of barcodes turns into a subject: subjects
1 to 5 are robots, the others landmarks. Robots can be taken as moving landmarks; their references give the positions.
"""

import heapq
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from pathlib import Path

import msgspec
import numpy as np
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, Odometry, RobotState
from msgspec import UNSET

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.heading import GAP_S, heading_faults
from dynpf_formats.importers.log import ImportedLog, Losses, Record
from dynpf_formats.importers.mrclam_tables import MrclamTexts, Reading, Tables, TextFile, tables_of
from dynpf_formats.importers.text import lines_of
from dynpf_formats.recording.attachments import attached_landmarks
from dynpf_formats.regular_files import exists

__all__ = ["import_mrclam", "import_mrclam_team", "robots_in"]

ROBOTS = range(1, 6)
MAX_READINGS = 256  # of one LandmarkReadings message
ORDER = {"log/truth": 0, "log/odometry": 1, "log/landmarks": 2}  # of records with the same time

_ROBOT_PREFIX = re.compile(r"Robot(\d+)_$")


def import_mrclam(folder: Path, robot: int | None = None, *, robots: bool = False) -> ImportedLog:
    """Return one robot's log of the data set in ``folder``; with ``robots``, the others are moving landmarks.

    ``robot`` may be left out if the folder has a single robot. Raises ImportFailedError for a missing or unreadable
    file, for a robot that is not there, and for every line that does not fit its table.
    """
    prefix, number = _choose(folder, robot)
    common = "" if number is not None else prefix
    names = (
        f"{common}Barcodes",
        f"{common}Landmark_Groundtruth",
        f"{prefix}Odometry",
        f"{prefix}Measurement",
        f"{prefix}Groundtruth",
    )
    if robots and number is None:
        raise ImportFailedError(f"{folder}: its one robot has no number, so the other robots are not known")
    others = [other for other in ROBOTS if robots and other != number]
    texts: list[TextFile] = []
    problems: list[str] = []
    for name in (*names, *(f"Robot{other}_Groundtruth" for other in others)):
        try:
            texts.append(_read(folder, name))
        except ImportFailedError as error:
            problems += error.problems
    if problems:
        raise ImportFailedError(*problems)
    moving = dict(zip(others, texts[len(names) :], strict=True))
    return _log(MrclamTexts(*texts[: len(names)]), folder.name, number, moving)


def import_mrclam_team(folder: Path) -> ImportedLog:
    """Return the logs of all robots of the data set in ``folder`` as one, on topics such as ``r1/log/odometry``.

    They share one clock and one map. Raises ImportFailedError as ``import_mrclam`` does.
    """
    logs = {f"r{number}": import_mrclam(folder, number) for number in robots_in(folder)}
    if not logs:
        raise ImportFailedError(f"{folder}: its one robot has no number; leave out --robot all to import it")
    losses = Losses()
    for robot, log in logs.items():
        for reason, dropped in log.losses.summary().items():
            losses.add(f"{robot}: {reason}", dropped.first, dropped.count)
    settings = {f"{robot}_{name}": value for robot, log in logs.items() for name, value in log.settings.items()}
    records = heapq.merge(*(_on_topics_of(*item) for item in logs.items()), key=lambda record: record.stamp_ns)
    return ImportedLog(folder.name, "mrclam", settings, records, losses, next(iter(logs.values())).attachments)


def _on_topics_of(robot: str, log: ImportedLog) -> Iterator[Record]:
    for record in log.records:
        yield record._replace(topic=f"{robot}/{record.topic}")


def robots_in(folder: Path) -> list[int]:
    """Return the numbers of the robots in a data set, none if its single robot has no number."""
    return sorted(_robots(_prefixes(folder)))


def _prefixes(folder: Path) -> set[str]:
    return {
        path.name.partition("Odometry.dat")[0]
        for path in folder.glob("*Odometry.dat*")
        if path.suffix in (".dat", ".xz")
    }


def _robots(prefixes: Iterable[str]) -> dict[int, str]:
    return {int(match[1]): prefix for prefix in prefixes if (match := _ROBOT_PREFIX.match(prefix))}


def _choose(folder: Path, robot: int | None) -> tuple[str, int | None]:
    """Return the prefix of the robot's files, and its number unless the folder's single robot has none."""
    if not folder.is_dir():
        raise ImportFailedError(f"{folder}: no such folder; expected one with the tables of a MRCLAM data set")
    found = _prefixes(folder)
    robots = _robots(found)
    if not found:
        raise ImportFailedError(f"{folder}: no file named Robot1_Odometry.dat or *Odometry.dat, nor .xz of it")
    if not robots:
        if len(found) > 1:
            names = ", ".join(f"{prefix}Odometry.dat" for prefix in sorted(found))
            raise ImportFailedError(f"{folder}: {names}; expected one robot's tables, or Robot1_ and so on as prefix")
        if robot is not None:
            raise ImportFailedError(f"{folder}: robot {robot} asked for, but its one robot has no number; ask for none")
        return found.pop(), None
    listed = ", ".join(map(str, sorted(robots)))
    if robot is None:
        if len(robots) > 1:
            raise ImportFailedError(f"{folder}: has robots {listed}; choose one")
        robot = next(iter(robots))
    if robot not in robots:
        raise ImportFailedError(f"{folder}: no robot {robot}; it has {listed}")
    return robots[robot], robot


def _read(folder: Path, name: str) -> TextFile:
    """Read a table, plain or compressed."""
    plain, packed = folder / f"{name}.dat", folder / f"{name}.dat.xz"
    path = plain if exists(plain) else packed
    if not exists(path):
        raise ImportFailedError(f"{plain}: no such file, nor {packed.name}")
    return TextFile(path.name, [line.rstrip("\r\n") for _, line in lines_of(path)])


def _log(texts: MrclamTexts, source: str, robot: int | None, moving: Mapping[int, TextFile]) -> ImportedLog:
    """Return the log in the five tables; ``moving`` are the references of other robots, by subject.

    Readings with the same time make one message. Raises ImportFailedError with every line that does not fit its table.
    """
    tables = tables_of(texts, moving)
    losses = Losses()
    readings = sorted(_readings(tables, losses), key=lambda row: row.stamp_ns)
    odometry, references = (sorted(rows, key=lambda row: row.stamp_ns) for rows in (tables.odometry, tables.references))
    truth, faults, gaps = _checked(references, odometry)
    records = sorted(
        [*truth, *odometry, *_grouped(readings)], key=lambda record: (record.stamp_ns, ORDER[record.topic])
    )
    start_ns = records[0].stamp_ns
    settings = {
        "robot": robot,
        "landmarks": len(tables.landmarks),
        "landmark_readings": len(readings),
        "robot_readings": sum(row.position is not None for row in readings),
        "clock_backwards": tables.late,  # rows older than the previous row of their table; they are sorted by time
        "reference_gaps_s": [_since(start_ns, first, last) for first, last in gaps],
        "heading_faults_s": [_since(start_ns, first, last) for first, last in faults],
    }
    return ImportedLog(source, "mrclam", settings, tuple(records), losses, (attached_landmarks(tables.landmarks),))


def _readings(tables: Tables, losses: Losses) -> Iterator[Reading]:
    """Yield the readings of landmarks with a position, and of robots whose position at that time is known."""
    ids = frozenset(landmark.id for landmark in tables.landmarks)
    for row in tables.measurements:
        subject = tables.barcodes.get(row.barcode)
        where = f"{row.stamp_ns * 1e-9:.3f} s"
        if subject is None:
            losses.add("readings of unknown barcodes", f"{where}: barcode {row.barcode}")
            continue
        path = tables.paths.get(subject)
        position = None if path is None else path.at(row.stamp_ns)
        if subject in ids or position is not None:
            yield Reading(row.stamp_ns, subject, row.range, row.bearing, position)
        elif subject in ROBOTS:
            losses.add("readings of other robots", f"{where}: subject {subject}")
        else:
            losses.add("readings of landmarks without a position", f"{where}: subject {subject}")


def _grouped(readings: Sequence[Reading]) -> Iterator[Record]:
    """Yield one message for the readings with the same stamp."""
    for stamp_ns, rows in groupby(readings, key=lambda row: row.stamp_ns):
        moment = tuple(
            LandmarkReading(
                landmark=row.subject,
                range=row.range,
                bearing=row.bearing,
                x=UNSET if row.position is None else row.position[0],
                y=UNSET if row.position is None else row.position[1],
            )
            for row in rows
        )
        for first in range(0, len(moment), MAX_READINGS):
            yield Record("log/landmarks", stamp_ns, LandmarkReadings(readings=moment[first : first + MAX_READINGS]))


Spans = list[tuple[int, int]]


def _checked(references: Sequence[Record], odometry: Sequence[Record]) -> tuple[list[Record], Spans, Spans]:
    """Mark references with a faulty heading; return all references, the faults, and the gaps (first and last stamp)."""
    poses = [record.message for record in references if isinstance(record.message, RobotState)]
    speeds = [record.message.v for record in odometry if isinstance(record.message, Odometry)]
    stamps = np.array([record.stamp_ns for record in references], dtype=np.int64)
    held = np.searchsorted([record.stamp_ns for record in odometry], stamps, side="right") - 1
    faulty = heading_faults(
        (stamps - stamps[:1]) / 1e9,
        np.array([(pose.x, pose.y, pose.theta) for pose in poses]).reshape(-1, 3),
        np.array(speeds)[np.maximum(held, 0)] < 0.0,
    )
    truth = [
        Record("log/truth", record.stamp_ns, msgspec.structs.replace(pose, heading_valid=False) if bad else pose)
        for record, pose, bad in zip(references, poses, faulty.tolist(), strict=True)
    ]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], faulty, [False]]).astype(np.int8, casting="safe"))).tolist()
    faults = [
        (references[a].stamp_ns, references[b - 1].stamp_ns) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    gaps = [
        (before.stamp_ns, after.stamp_ns)
        for before, after in pairwise(references)
        if after.stamp_ns - before.stamp_ns > GAP_S * 1e9
    ]
    return truth, faults, gaps


def _since(start_ns: int, first_ns: int, last_ns: int) -> tuple[float, float]:
    """Return a span in seconds after the start of the log."""
    return (first_ns - start_ns) / 1e9, (last_ns - start_ns) / 1e9
