"""An imported log: its records in order, the landmarks they speak of, and what was found on the way."""

from typing import NamedTuple

import msgspec
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Message

__all__ = ["ImportSummary", "ImportedLog", "Record"]

Span = tuple[float, float]
"""First and last second, counted from the log's first record."""


class Record(NamedTuple):
    """One record: its topic, its time in nanoseconds on the log's own clock, and the message."""

    topic: str
    stamp_ns: int
    message: Message


class ImportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a log holds and what of it was left out."""

    source: str
    robot: int | None  # None: the log is of a single robot without a number
    start_ns: int
    duration_s: float
    odometry: int  # messages
    landmark_messages: int
    landmark_readings: int
    references: int  # reference poses
    landmarks: int  # on the map
    robot_readings: int  # of these, readings of other robots, taken for landmarks that move
    dropped_robots: int  # readings of other robots that were not
    dropped_unknown_barcodes: int  # readings of barcodes that no table has
    dropped_unmapped: int  # readings of landmarks without a surveyed position
    clock_backwards: int  # rows older than the one before them in their table; they are put in order of time
    reference_gaps: tuple[Span, ...]
    heading_faults: tuple[Span, ...]


class ImportedLog(NamedTuple):
    """A whole log in memory; records are in time order."""

    records: tuple[Record, ...]
    landmarks: tuple[Landmark, ...]
    summary: ImportSummary
