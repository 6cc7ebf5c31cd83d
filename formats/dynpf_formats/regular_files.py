"""Opens files whose names come from people or from other files: only regular ones, and no more of them than is wanted.

A pipe or a device would block its reader, or never end.
"""

import errno
import io
import os
import stat
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # not on this system: nobody claims a file there
    fcntl = None  # type: ignore[assignment]

__all__ = ["LARGEST", "claim", "exists", "is_claimed", "open_regular", "read_regular", "readable"]

LARGEST = 2**28
"""Bytes of a file that is read as a whole."""


def open_regular(path: Path | str) -> io.BufferedReader:
    """Open a regular file for reading; raises OSError for anything else, without reading from it."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe would wait for its other end
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "a pipe or a device; expected a regular file", str(path))


def read_regular(path: Path | str, largest: int = LARGEST) -> bytes:
    """Return the content of a regular file; raises OSError for any other, and for one of more than ``largest`` bytes.

    Raises ValueError for a path with a null character.
    """
    with open_regular(path) as stream:
        data = stream.read(largest + 1)
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"more than {largest} bytes", str(path))
    return data


def exists(path: Path) -> bool:
    """Return whether there is a file; no name is too long to be asked for."""
    try:
        path.lstat()
    except (OSError, ValueError):
        return False  # opening it tells what is wrong with the name
    return True


def claim(descriptor: int) -> None:
    """Mark an open file as being written, for as long as it is open; where that cannot be done, do nothing."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_claimed(path: Path) -> bool:
    """Return whether a process says that it is writing a file."""
    if fcntl is None:
        return False
    with open_regular(path) as stream:
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return False


def readable(name: Path | str) -> str:
    """Return a name as text that can be encoded: bytes that are no UTF-8 become ``\\xff``."""
    return os.fsencode(name).decode(errors="backslashreplace")
