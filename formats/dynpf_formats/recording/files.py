"""The file that a recording is written into, and what is told if it cannot be."""

import errno
import os
from pathlib import Path
from typing import Protocol

from dynpf_formats.recording.errors import RecordingError, RecordingExistsError
from dynpf_formats.regular_files import claim

__all__ = ["File", "PlainFile", "already_there", "unwritable"]


class File(Protocol):
    """What a recording is written into. What is written survives its process; what is synced, a loss of power too."""

    def write(self, data: bytes) -> int:
        """Write all of ``data``; raises OSError."""

    def tell(self) -> int:
        """Return the number of bytes written."""

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        """Return when all that is written is on the disk; raises OSError."""

    def close(self) -> None:
        """Close the file."""


class PlainFile:
    """An unbuffered file: written data survive a full disk and a killed process."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        self._raw = path.open("wb" if overwrite else "xb", buffering=0)
        claim(self._raw.fileno())
        self._position = 0

    def write(self, data: bytes) -> int:
        """Write all of ``data``."""
        view = memoryview(data)
        while view:
            written = self._raw.write(view)
            view = view[written:]
            self._position += written
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        """Return when all that is written is on the disk."""
        os.fsync(self._raw.fileno())

    def close(self) -> None:
        """Close the file."""
        self._raw.close()


def unwritable(path: Path, error: OSError) -> RecordingError:
    """Return what to tell of a file that cannot be written any more."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return RecordingError(
            f"{path}: no room left to write ({os.strerror(error.errno)}); what was written can be recovered"
        )
    return RecordingError(f"{path}: cannot be written: {error.strerror}")


def already_there(path: Path) -> RecordingExistsError:
    """Return what to tell of a file that is there already."""
    return RecordingExistsError(f"{path}: the file exists; choose another name or overwrite it")
