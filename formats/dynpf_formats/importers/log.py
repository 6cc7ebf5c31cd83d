"""An imported log in memory: its records in order, its landmarks, and a summary."""

from typing import NamedTuple

import msgspec
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import Message

__all__ = ["ImportSummary", "ImportedLog", "Record"]

Span = tuple[float, float]
"""First and last second, relative to the log's first record."""


class Record(NamedTuple):
    """One record: its topic, its time in nanoseconds on the log's own clock, and the message."""

    topic: str
    stamp_ns: int
    message: Message


class ImportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a log holds, and what was left out."""

    source: str
    robot: int | None  # None: the log is of a single robot without a number
    start_ns: int
    duration_s: float
    odometry: int  # messages
    landmark_messages: int
    landmark_readings: int
    references: int  # reference poses
    landmarks: int  # on the map
    robot_readings: int  # of these, readings of other robots, taken as moving landmarks
    dropped_robots: int  # readings of other robots that were not taken
    dropped_unknown_barcodes: int  # readings of barcodes that no table has
    dropped_unmapped: int  # readings of landmarks without a surveyed position
    clock_backwards: int  # rows older than the previous row of their table; they are sorted by time
    reference_gaps: tuple[Span, ...]
    heading_faults: tuple[Span, ...]


class ImportedLog(NamedTuple):
    """A whole log; records are in order of time."""

    records: tuple[Record, ...]
    landmarks: tuple[Landmark, ...]
    summary: ImportSummary
