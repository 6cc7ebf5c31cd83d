"""Opens files whose names come from people or from other files: only regular ones, and no more of them than is wanted.

A pipe or a device would block its reader, or never end.
"""

import errno
import io
import os
import stat
from pathlib import Path

__all__ = ["LARGEST", "exists", "open_regular", "read_regular", "readable"]

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


def readable(name: Path | str) -> str:
    """Return a name as text that can be encoded: bytes that are no UTF-8 become ``\\xff``."""
    return os.fsencode(name).decode(errors="backslashreplace")
