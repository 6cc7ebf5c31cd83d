"""Importer of UTIAS MRCLAM logs (Leung et al., IJRR 30(8), 2011): odometry, range and bearing, motion-capture poses.

A data set is a folder of text tables: Barcodes, Landmark_Groundtruth, and for each robot Odometry, Measurement and
Groundtruth, named ``Robot1_Odometry.dat`` and so on; or of a single robot, under any other prefix or none. Each may
be compressed, as ``.dat.xz``. A measurement names a barcode, which the table of barcodes turns into a subject: subjects
1 to 5 are robots, the others landmarks. Robots can be taken as moving landmarks; their references give the positions.
"""

import lzma
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import LandmarkReading, LandmarkReadings, Odometry, RobotState
from msgspec import UNSET
from numpy.typing import NDArray

from dynpf.types import FloatArray
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.heading import GAP_S, heading_faults
from dynpf_formats.importers.log import ImportedLog, ImportSummary, Record, Span
from dynpf_formats.importers.text import LFS_POINTER, finite_number, seconds_to_ns, whole_number

__all__ = ["MrclamTexts", "TextFile", "import_mrclam", "import_mrclam_team", "parse_mrclam", "robots_in"]

ROBOTS = range(1, 6)
MAX_READINGS = 256  # of one LandmarkReadings message
ORDER = {"log/truth": 0, "log/odometry": 1, "log/landmarks": 2}  # of records with the same time

_ROBOT_PREFIX = re.compile(r"Robot(\d+)_$")

Row = TypeVar("Row")


class TextFile(NamedTuple):
    """A table's name, for messages about it, and its lines."""

    name: str
    lines: Sequence[str]


class MrclamTexts(NamedTuple):
    """The five tables that make up one robot's log."""

    barcodes: TextFile
    landmarks: TextFile
    odometry: TextFile
    measurements: TextFile
    references: TextFile


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
        raise ImportFailedError(
            f"{folder}: its one robot has no number, so the others' references cannot be told apart"
        )
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
    return parse_mrclam(MrclamTexts(*texts[: len(names)]), source=folder.name, robot=number, moving=moving)


def import_mrclam_team(folder: Path) -> tuple[ImportedLog, ...]:
    """Return the log of each robot of the data set in ``folder``, on that robot's topics, such as ``r1/log/odometry``.

    All share one clock and one map. Raises ImportFailedError as ``import_mrclam`` does.
    """
    logs = []
    for number in robots_in(folder):
        log = import_mrclam(folder, number)
        logs.append(log._replace(records=tuple(item._replace(topic=f"r{number}/{item.topic}") for item in log.records)))
    if not logs:
        raise ImportFailedError(f"{folder}: its one robot has no number; leave out --robot all to import it")
    return tuple(logs)


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
    path = plain if plain.exists() else packed
    try:
        data = path.read_bytes()
        if data.startswith(LFS_POINTER):
            raise ImportFailedError(f"{path}: a Git LFS pointer, not the file itself; fetch it with `git lfs pull`")
        text = lzma.decompress(data) if path == packed else data
    except FileNotFoundError:
        raise ImportFailedError(f"{plain}: no such file, nor {packed.name}") from None
    except (OSError, lzma.LZMAError) as error:
        raise ImportFailedError(f"{path}: cannot be read: {error}") from error
    return TextFile(path.name, text.decode("utf-8", errors="replace").splitlines())


def parse_mrclam(
    texts: MrclamTexts, *, source: str, robot: int | None, moving: Mapping[int, TextFile] | None = None
) -> ImportedLog:
    """Return the log in the five tables; ``moving`` are the references of other robots, by subject.

    Readings with the same time make one message. Raises ImportFailedError with every line that does not fit its table.
    """
    tables = _tables_of(texts, moving or {})
    ids = frozenset(landmark.id for landmark in tables.landmarks)
    known = [_reading(row, tables.barcodes.get(row.barcode), tables.paths) for row in tables.measurements]
    readings = sorted(
        (row for row in known if row.subject in ids or row.position is not None), key=lambda row: row.stamp_ns
    )
    odometry, references = (sorted(rows, key=lambda row: row.stamp_ns) for rows in (tables.odometry, tables.references))
    groups = list(_grouped(readings))
    truth, faults, gaps = _checked(references, odometry)

    records = sorted([*truth, *odometry, *groups], key=lambda record: (record.stamp_ns, ORDER[record.topic]))
    start = records[0].stamp_ns
    summary = ImportSummary(
        source=source,
        robot=robot,
        start_ns=start,
        duration_s=(records[-1].stamp_ns - start) / 1e9,
        odometry=len(odometry),
        landmark_messages=len(groups),
        landmark_readings=len(readings),
        references=len(truth),
        landmarks=len(tables.landmarks),
        robot_readings=sum(row.position is not None for row in known),
        dropped_robots=sum(
            int(row.subject in ROBOTS and row.subject not in ids and row.position is None) for row in known
        ),
        dropped_unknown_barcodes=sum(row.subject is None for row in known),
        dropped_unmapped=sum(
            int(row.subject is not None and row.subject not in ROBOTS and row.subject not in ids) for row in known
        ),
        clock_backwards=tables.late,
        reference_gaps=tuple(_since(start, first, last) for first, last in gaps),
        heading_faults=tuple(_since(start, first, last) for first, last in faults),
    )
    return ImportedLog(tuple(records), tables.landmarks, summary)


class _Tables(NamedTuple):
    """The rows of one robot's tables, and how often their clocks go back."""

    barcodes: Mapping[int, int]  # barcode -> subject
    landmarks: tuple[Landmark, ...]
    odometry: list[Record]
    measurements: "list[_Measurement]"
    references: list[Record]
    paths: "Mapping[int, _Path]"  # of other robots, by subject
    late: int


def _tables_of(texts: MrclamTexts, moving: Mapping[int, TextFile]) -> _Tables:
    """Read the tables; raises ImportFailedError with every line that does not fit its table."""
    problems: list[str] = []
    pairs = list(_table(texts.barcodes, _barcode, problems))
    landmarks = tuple(_table(texts.landmarks, _landmark, problems))
    odometry = list(_table(texts.odometry, _odometry, problems))
    measurements = list(_table(texts.measurements, _measurement, problems))
    references = list(_table(texts.references, _reference, problems))
    paths = {subject: _Path.of(_table(file, _reference, problems)) for subject, file in moving.items()}
    needed = ((texts.barcodes.name, pairs), (texts.landmarks.name, landmarks), (texts.odometry.name, odometry))
    for name, rows in needed:
        if not rows and not problems:
            problems.append(f"{name}: holds no record")
    problems += [
        f"{texts.barcodes.name}: barcode {code} has two subjects" for code in _twice(code for code, _ in pairs)
    ]
    doubles = _twice(landmark.id for landmark in landmarks)
    problems += [f"{texts.landmarks.name}: subject {subject} has two positions" for subject in doubles]
    if problems:
        raise ImportFailedError(*problems)
    clocked: tuple[Sequence[Record | _Measurement], ...] = (odometry, measurements, references)
    late = sum(later.stamp_ns < before.stamp_ns for rows in clocked for before, later in pairwise(rows))
    return _Tables(dict(pairs), landmarks, odometry, measurements, references, paths, late)


class _Measurement(NamedTuple):
    stamp_ns: int
    barcode: int
    range: float
    bearing: float


class _Reading(NamedTuple):
    stamp_ns: int
    subject: int | None  # None: no table has the barcode
    range: float
    bearing: float
    position: tuple[float, float] | None = None  # m, of a robot


class _Path(NamedTuple):
    """A robot's reference: stamps (T,) in ns and positions (T,) in metres."""

    stamps: NDArray[np.int64]
    x: FloatArray
    y: FloatArray

    @classmethod
    def of(cls, records: Iterable[Record]) -> "_Path":
        """Return the path through the poses among the records."""
        rows = sorted(
            (record.stamp_ns, record.message.x, record.message.y)
            for record in records
            if isinstance(record.message, RobotState)
        )
        stamps, x, y = zip(*rows, strict=True) if rows else ((), (), ())
        return cls(np.array(stamps, dtype=np.int64), np.array(x), np.array(y))

    def at(self, stamp_ns: int) -> tuple[float, float] | None:
        """Return the robot's position, interpolated between references close in time; None if there are none."""
        after = int(np.searchsorted(self.stamps, stamp_ns, side="left"))
        if after < self.stamps.size and self.stamps[after] == stamp_ns:
            return float(self.x[after]), float(self.y[after])
        if not 0 < after < self.stamps.size:
            return None
        before, span = after - 1, int(self.stamps[after] - self.stamps[after - 1])
        if span > GAP_S * 1e9:
            return None
        share = (stamp_ns - int(self.stamps[before])) / span
        x, y = ((1.0 - share) * axis[before] + share * axis[after] for axis in (self.x, self.y))
        return float(x), float(y)


def _reading(row: _Measurement, subject: int | None, paths: Mapping[int, _Path]) -> _Reading:
    """Return a measurement with its subject, and the subject's position if it is a robot whose path is known."""
    path = None if subject is None else paths.get(subject)
    return _Reading(row.stamp_ns, subject, row.range, row.bearing, None if path is None else path.at(row.stamp_ns))


def _table(file: TextFile, parse: Callable[[list[str]], Row], problems: list[str]) -> Iterator[Row]:
    """Yield the rows of a table; append rows that cannot be parsed to ``problems``, with file and line."""
    for number, line in enumerate(file.lines, start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            yield parse(fields)
        except ValueError as error:
            problems.append(f"{file.name}:{number}: {error}")


def _barcode(fields: list[str]) -> tuple[int, int]:
    subject, barcode = _columns(fields, 2)
    return whole_number(barcode, "barcode"), whole_number(subject, "subject")


def _landmark(fields: list[str]) -> Landmark:
    subject, x, y, _, _ = _columns(fields, 5)
    return Landmark(id=whole_number(subject, "subject"), x=finite_number(x, "x"), y=finite_number(y, "y"))


def _odometry(fields: list[str]) -> Record:
    time, v, w = _columns(fields, 3)
    return Record("log/odometry", seconds_to_ns(time), Odometry(v=finite_number(v, "v"), w=finite_number(w, "w")))


def _measurement(fields: list[str]) -> _Measurement:
    time, barcode, distance, bearing = _columns(fields, 4)
    value = finite_number(distance, "range")
    if value < 0.0:
        raise ValueError(f"range is {distance!r}; expected 0 or more")
    turned = math.remainder(finite_number(bearing, "bearing"), math.tau)
    return _Measurement(seconds_to_ns(time), whole_number(barcode, "barcode"), value, turned)


def _reference(fields: list[str]) -> Record:
    time, x, y, theta = _columns(fields, 4)
    pose = RobotState(x=finite_number(x, "x"), y=finite_number(y, "y"), theta=finite_number(theta, "orientation"))
    return Record("log/truth", seconds_to_ns(time), pose)


def _columns(fields: list[str], count: int) -> list[str]:
    if len(fields) != count:
        raise ValueError(f"{len(fields)} columns in {' '.join(fields)[:60]!r}; expected {count}")
    return fields


def _twice(numbers: Iterable[int]) -> list[int]:
    return [number for number, count in Counter(numbers).items() if count > 1]


def _grouped(readings: Sequence[_Reading]) -> Iterator[Record]:
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
            if row.subject is not None
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


def _since(start_ns: int, first_ns: int, last_ns: int) -> Span:
    return (first_ns - start_ns) / 1e9, (last_ns - start_ns) / 1e9
