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
    """The file to be written already exists."""


class NotMcapError(RecordingError):
    """The file is empty, or is not MCAP."""


class ForeignRecordingError(RecordingError):
    """The file is MCAP, but no dynpf recording."""


class UnreadableHeaderError(RecordingError):
    """The metadata of the run cannot be read, so the messages cannot be interpreted."""


class UnknownVersionError(RecordingError):
    """The recording has a schema version that this dynpf does not read."""


class TruncatedRecordingError(RecordingError):
    """The file ends before its footer: its writer did not finish."""


class CorruptRecordingError(RecordingError):
    """The file does not hold the bytes that were written: a checksum or the framing is wrong."""
