"""Bounds on what a ROS bag may unpack to, checked before or while the package rosbags reads it, which sets none."""

import bz2
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame  # rosbags needs it, too
from mcap.records import Header

from dynpf_formats.importers.errors import ImportFailedError
from dynpf_formats.recording.mcap_records import MAGIC, MAX_RECORD, Damage, DamageKind, Region, scan
from dynpf_formats.regular_files import open_regular

__all__ = ["bound_chunks", "check_mcap"]

_FRAME = struct.Struct("<BQ")  # opcode and length before each record
_MOST_RECORDS, _BYTES_A_RECORD = 20_000, 4
"""The chunks of an MCAP file hold at most so many records, and besides one for so many bytes of the file."""


def check_mcap(path: Path) -> None:
    """Raise ImportFailedError for an MCAP file whose chunks unpack to more bytes or records than a bag of its size has.

    A file with ROS 1 messages is refused, too. Other damage is left to who reads the bag.
    """
    with open_regular(path) as stream:
        size = path.stat().st_size
        if stream.read(len(MAGIC)) != MAGIC:
            return
        most = left = _MOST_RECORDS + size // _BYTES_A_RECORD
        for item in scan(stream, size):
            match item:
                case Header(profile="ros1"):
                    raise ImportFailedError(
                        f"{path}: holds ROS 1 messages in MCAP, which are not read; import the .bag that it was made "
                        "from, or convert that to ROS 2 (rosbags-convert)"
                    )
                case Damage(DamageKind.OVERSIZE, offset, text):
                    raise ImportFailedError(f"{path}: at byte {offset}: {text}")
                case Region(offset, _, data):
                    left -= _count_records(data, left)
                    if left < 0:
                        raise ImportFailedError(
                            f"{path}: the chunk at byte {offset} brings the file of {size} bytes to more than {most} "
                            "records, more than any bag of that size has"
                        )


def _count_records(data: bytes, most: int) -> int:
    """Return how many records a chunk has; it stops counting after ``most``."""
    start = count = 0
    while start + _FRAME.size <= len(data) and count <= most:
        start += _FRAME.size + _FRAME.unpack_from(data, start)[1]
        count += 1
    return count


def bound_chunks(reader: Any) -> None:
    """Let an open reader of a ROS 1 bag unpack no chunk to more than MAX_RECORD bytes; it then raises ValueError."""
    bounded = {bz2.decompress: bz2.BZ2Decompressor, lz4.frame.decompress: lz4.frame.LZ4FrameDecompressor}
    for position, chunk in reader.chunks.items():
        if (decompressor := bounded.get(chunk.decompressor)) is not None:
            reader.chunks[position] = chunk._replace(decompressor=_bounded(decompressor))


def _bounded(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    def unpack(data: bytes) -> bytes:
        unpacked: bytes = decompressor().decompress(data, MAX_RECORD + 1)
        if len(unpacked) > MAX_RECORD:
            raise ValueError(f"a chunk unpacks to more than {MAX_RECORD} bytes")
        return unpacked

    return unpack
