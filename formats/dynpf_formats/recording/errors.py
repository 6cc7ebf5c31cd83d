"""Errors of recordings; each text names the file."""

from dynpf_protocol.errors import DynpfError

__all__ = [
    "CorruptRecordingError",
    "ForeignRecordingError",
    "NotMcapError",
    "RecordingError",
    "RecordingExistsError",
    "TruncatedRecordingError",
    "UnknownVersionError",
    "UnreadableHeaderError",
]


class RecordingError(DynpfError):
    """A recording cannot be written or read."""


class RecordingExistsError(RecordingError):
    """The file to be written is already there."""


class NotMcapError(RecordingError):
    """The file is empty, or something else than MCAP."""


class ForeignRecordingError(RecordingError):
    """The file is MCAP, but somebody else's."""


class UnreadableHeaderError(RecordingError):
    """The metadata of the run cannot be read, so nothing says what the messages mean."""


class UnknownVersionError(RecordingError):
    """The recording has a schema version that this dynpf does not read."""


class TruncatedRecordingError(RecordingError):
    """The file ends before its footer: whoever wrote it did not finish."""


class CorruptRecordingError(RecordingError):
    """The file holds other bytes than were written: a checksum or the framing is wrong."""
