"""A foreign log that is read while it is written down: its records one by one, and an account of what was left out."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import msgspec

from dynpf_formats.importers.log import Record
from dynpf_formats.recording.header import Attachment

__all__ = ["Dropped", "LogStream", "Losses", "StreamSummary"]


class Dropped(msgspec.Struct, frozen=True):
    """How much was left out for one reason, and what the first of it was."""

    count: int
    first: str


class Losses:
    """What an importer leaves out, by reason; it grows while records are taken."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._first: dict[str, str] = {}

    def add(self, reason: str, example: str, count: int = 1) -> None:
        """Count what is left out; ``example`` tells where and what, in a few words."""
        self._counts[reason] = self._counts.get(reason, 0) + count
        self._first.setdefault(reason, example)

    def told(self) -> dict[str, Dropped]:
        """Return what was left out so far, by reason."""
        return {reason: Dropped(count, self._first[reason]) for reason, count in self._counts.items()}


class LogStream(NamedTuple):
    """A log of any length. ``losses`` are complete when ``records`` are at their end.

    ``settings`` tell how the source was read: what was chosen, and what was found in it. Records come in the order in
    which they shall be played.
    """

    source: str
    format: str
    settings: Mapping[str, Any]
    records: Iterator[Record]
    losses: Losses
    attachments: tuple[Attachment, ...] = ()


class StreamSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What was written of a log and what of it was left out."""

    source: str
    format: str
    settings: Mapping[str, Any]
    start_ns: int
    duration_s: float
    messages: dict[str, int]  # topic -> messages
    attachments: tuple[str, ...]
    dropped: dict[str, Dropped]  # by reason
