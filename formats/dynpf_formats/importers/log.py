"""An imported log: its records in order, where they come from, and what was left out."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.messages import Message

from dynpf_formats.recording.header import Attachment

__all__ = ["Dropped", "ImportSummary", "ImportedLog", "Losses", "Record"]


class Record(NamedTuple):
    """One record: its topic, its time in nanoseconds on the log's own clock, and the message."""

    topic: str
    stamp_ns: int
    message: Message


class Dropped(msgspec.Struct, frozen=True):
    """How much was left out for one reason, with the first example."""

    count: int
    first: str


class Losses:
    """Counts what an importer leaves out, by reason, while the records are read."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._first: dict[str, str] = {}

    def add(self, reason: str, example: str, count: int = 1) -> None:
        """Count something left out; ``example`` says in a few words where and what it was."""
        self._counts[reason] = self._counts.get(reason, 0) + count
        self._first.setdefault(reason, example)

    def summary(self) -> dict[str, Dropped]:
        """Return what has been left out so far, by reason."""
        return {reason: Dropped(count, self._first[reason]) for reason, count in self._counts.items()}


class ImportedLog(NamedTuple):
    """A log of any length. ``losses`` are complete once ``records`` are exhausted.

    ``settings`` describe how the source was read: what was chosen, and what was found in it. Records are in the order
    in which they are to be played; they may be an iterator, which reads the source as the recording is written.
    """

    source: str
    format: str
    settings: Mapping[str, Any]
    records: Iterable[Record]
    losses: Losses
    attachments: tuple[Attachment, ...] = ()


class ImportSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What was written of a log, and what was left out."""

    source: str
    format: str
    settings: Mapping[str, Any]
    start_ns: int
    duration_s: float
    messages: dict[str, int]  # topic -> messages
    attachments: tuple[str, ...]
    dropped: dict[str, Dropped]  # by reason
    warnings: tuple[str, ...] = ()
