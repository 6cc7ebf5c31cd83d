"""Reads foreign text files, plain or compressed, and the numbers in them."""

import bz2
import gzip
import lzma
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import IO

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.regular_files import open_regular

__all__ = ["LFS_POINTER", "finite_number", "lines_of", "refuse_pointer", "seconds_to_ns", "whole_number"]

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
MOST_UNPACKED, MOST_RATIO = 2**20, 100  # bytes, and times the size of the packed file; logs have some ten times
LONGEST_LINE = 2**18  # bytes; a scan of 3600 beams has some 30,000

_PACKED: Mapping[bytes, Callable[[Path], IO[bytes] | gzip.GzipFile]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
    b"BZh": bz2.BZ2File,
}


def refuse_pointer(path: Path) -> None:
    """Raise ImportFailedError if a file is missing or empty, or only a Git LFS pointer."""
    try:
        with open_regular(path) as stream:
            start = stream.read(len(LFS_POINTER))
    except OSError as error:
        raise ImportFailedError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from error
    if start == LFS_POINTER:
        raise ImportFailedError(f"{path}: a Git LFS pointer, not the file itself; fetch it with `git lfs pull`")
    if not start:
        raise ImportFailedError(f"{path}: the file is empty")


def lines_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file with their numbers from 1, unpacking gzip, xz and bzip2.

    Raises ImportFailedError at the first line that cannot be read.
    """
    refuse_pointer(path)
    number = 0
    try:
        with open_regular(path) as plain:
            magic = plain.read(6)
        unpack = next((opener for start, opener in _PACKED.items() if magic.startswith(start)), None)
        with open_regular(path) if unpack is None else unpack(path) as stream:
            left = path.stat().st_size * MOST_RATIO + MOST_UNPACKED
            while line := stream.readline(LONGEST_LINE):
                number += 1
                left -= len(line)
                if left < 0:
                    raise ImportFailedError(f"{path}: unpacks to over {MOST_RATIO} times its size; not a packed log")
                if len(line) == LONGEST_LINE:
                    raise ImportFailedError(f"{path}:{number}: a line of over {LONGEST_LINE} bytes; not a text log")
                yield number, line.decode("utf-8", errors="replace")
    except (OSError, EOFError, lzma.LZMAError, zlib.error) as error:
        raise ImportFailedError(f"{path}: cannot be read beyond line {number}: {str(error).lower()}") from error


def finite_number(text: str, name: str) -> float:
    """Return the number in a text; raises ValueError with its name unless it is finite."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{name} is {text[:60]!r}; expected a finite number")
    return value


def whole_number(text: str, name: str) -> int:
    """Return the whole number in a text; raises ValueError with its name unless it has one to nine digits."""
    if not (text.isascii() and text.isdigit()) or len(text) > 9:
        raise ValueError(f"{name} is {text[:60]!r}; expected a whole number")
    return int(text)


def seconds_to_ns(text: str) -> int:
    """Return a time in seconds as nanoseconds, by way of a decimal: a float has too few digits."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        seconds = Decimal("NaN")
    if not seconds.is_finite() or seconds < 0:
        raise ValueError(f"time is {text[:60]!r}; expected seconds, 0 or more")
    if seconds >= 2**63 // 10**9:
        raise ValueError(f"time is {text[:60]!r}, as in nanoseconds; expected seconds")
    return int(seconds * 10**9)
