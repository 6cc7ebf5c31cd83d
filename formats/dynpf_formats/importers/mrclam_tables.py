"""The text tables of a MRCLAM data set, parsed and checked line by line."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Odometry, RobotState
from numpy.typing import NDArray

from dynpf.types import FloatArray
from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.importers.heading import GAP_S
from dynpf_formats.importers.log import Record
from dynpf_formats.importers.text import finite_number, seconds_to_ns, whole_number

__all__ = ["Measurement", "MrclamTexts", "Reading", "Tables", "TextFile", "tables_of"]

Row = TypeVar("Row")

_MOST_COLUMNS = 9  # that are counted


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


class Tables(NamedTuple):
    """The rows of one robot's tables, and how often their clocks go back."""

    barcodes: Mapping[int, int]  # barcode -> subject
    landmarks: tuple[Landmark, ...]
    odometry: list[Record]
    measurements: "list[Measurement]"
    references: list[Record]
    paths: "Mapping[int, RobotPath]"  # of other robots, by subject
    late: int


def tables_of(texts: MrclamTexts, moving: Mapping[int, TextFile]) -> Tables:
    """Read the tables; raises ImportFailedError with every line that does not fit its table."""
    problems: list[str] = []
    pairs = list(_table(texts.barcodes, _barcode, problems))
    landmarks = tuple(_table(texts.landmarks, _landmark, problems))
    odometry = list(_table(texts.odometry, _odometry, problems))
    measurements = list(_table(texts.measurements, _measurement, problems))
    references = list(_table(texts.references, _reference, problems))
    paths = {subject: RobotPath.of(_table(file, _reference, problems)) for subject, file in moving.items()}
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
    clocked: tuple[Sequence[Record | Measurement], ...] = (odometry, measurements, references)
    late = sum(later.stamp_ns < before.stamp_ns for rows in clocked for before, later in pairwise(rows))
    return Tables(dict(pairs), landmarks, odometry, measurements, references, paths, late)


class Measurement(NamedTuple):
    """A row of the table of measurements: range in metres, bearing in radians."""

    stamp_ns: int
    barcode: int
    range: float
    bearing: float


class Reading(NamedTuple):
    """A measurement of a known subject: range in metres, bearing in radians."""

    stamp_ns: int
    subject: int
    range: float
    bearing: float
    position: tuple[float, float] | None = None  # m, of a robot


class RobotPath(NamedTuple):
    """A robot's reference: stamps (T,) in ns and positions (T,) in metres."""

    stamps: NDArray[np.int64]
    x: FloatArray
    y: FloatArray

    @classmethod
    def of(cls, records: Iterable[Record]) -> "RobotPath":
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


def _table(file: TextFile, parse: Callable[[list[str]], Row], problems: list[str]) -> Iterator[Row]:
    """Yield the rows of a table; append rows that cannot be parsed to ``problems``, with file and line."""
    for number, line in enumerate(file.lines, start=1):
        fields = line.split(maxsplit=_MOST_COLUMNS)
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


def _measurement(fields: list[str]) -> Measurement:
    time, barcode, distance, bearing = _columns(fields, 4)
    value = finite_number(distance, "range")
    if value < 0.0:
        raise ValueError(f"range is {distance!r}; expected 0 or more")
    turned = math.remainder(finite_number(bearing, "bearing"), math.tau)
    return Measurement(seconds_to_ns(time), whole_number(barcode, "barcode"), value, turned)


def _reference(fields: list[str]) -> Record:
    time, x, y, theta = _columns(fields, 4)
    pose = RobotState(x=finite_number(x, "x"), y=finite_number(y, "y"), theta=finite_number(theta, "orientation"))
    return Record("log/truth", seconds_to_ns(time), pose)


def _columns(fields: list[str], count: int) -> list[str]:
    if len(fields) != count:
        found = f"over {_MOST_COLUMNS}" if len(fields) > _MOST_COLUMNS else len(fields)
        raise ValueError(f"{found} columns in {' '.join(fields)[:60]!r}; expected {count}")
    return fields


def _twice(numbers: Iterable[int]) -> list[int]:
    return [number for number, count in Counter(numbers).items() if count > 1]
