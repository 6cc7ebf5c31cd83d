"""What an encoded image says of itself, before a decoder takes memory for it."""

import struct

__all__ = ["size_of"]

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_HEADER = 13  # bytes of a PNG's first chunk
_WITHOUT_SIZE = frozenset({0xC4, 0xC8, 0xCC})  # segments of a JPEG that are numbered among those of a frame


def size_of(data: bytes) -> tuple[int, int] | None:
    """Return width and height of a PNG or JPEG in pixels.

    None for other bytes, and for a PNG with a part that goes beyond them: OpenCV takes memory for what a part claims.
    """
    if data.startswith(_PNG):
        return _png_size(data)
    if data.startswith(_JPEG):
        return _jpeg_size(data)
    return None


def _png_size(data: bytes) -> tuple[int, int] | None:
    at = len(_PNG)
    if len(data) < at + 8 + _HEADER or struct.unpack_from(">I4s", data, at) != (_HEADER, b"IHDR"):
        return None
    width, height = struct.unpack_from(">II", data, at + 8)
    while at < len(data):
        if at + 12 > len(data):
            return None
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if at > len(data):
            return None
        if kind == b"IEND":
            break
    return int(width), int(height)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = len(_JPEG)
    while at + 9 <= len(data) and data[at] == 0xFF:
        kind, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= kind <= 0xCF and kind not in _WITHOUT_SIZE:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return int(width), int(height)
        at += 2 + length
    return None
