"""What an encoded image says of itself, before a decoder takes memory for it."""

import struct

__all__ = ["is_whole", "size_of"]

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_HEADER = 13  # bytes of a PNG's first chunk
_WITHOUT_SIZE = frozenset({0xC4, 0xC8, 0xCC})  # segments of a JPEG that are numbered among those of a frame


def size_of(data: bytes) -> tuple[int, int] | None:
    """Return width and height in pixels as the header of a PNG or JPEG tells them; None for other bytes."""
    if data.startswith(_PNG):
        at = len(_PNG)
        if len(data) < at + 16 or struct.unpack_from(">I4s", data, at) != (_HEADER, b"IHDR"):
            return None
        width, height = struct.unpack_from(">II", data, at + 8)
        return int(width), int(height)
    return _jpeg_size(data) if data.startswith(_JPEG) else None


def is_whole(data: bytes) -> bool:
    """Return whether no part of a PNG goes beyond its bytes: OpenCV takes memory for what a part claims."""
    at = len(_PNG)
    kind = b""
    while data.startswith(_PNG) and kind != b"IEND":
        if at + 12 > len(data):
            return False
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if at > len(data):
            return False
    return True


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = len(_JPEG)
    while at + 9 <= len(data) and data[at] == 0xFF:
        kind, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= kind <= 0xCF and kind not in _WITHOUT_SIZE:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return int(width), int(height)
        at += 2 + length
    return None
