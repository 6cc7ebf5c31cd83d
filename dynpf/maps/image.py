"""Encoded images as brightness."""

import re
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf.image_size import is_whole, size_of
from dynpf.maps.occupancy import MOST_CELLS, check_size
from dynpf.types import FloatArray

__all__ = ["Shades", "decode_image"]

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_GAP = rb"(?:\s|#[^\n]*\n)+"
_PIXMAP = re.compile(rb"P([2356])" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})")
_BITMAP = re.compile(rb"P([14])" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})\s")
_PNG = b"\x89PNG\r\n\x1a\n"


class Shades(NamedTuple):
    """Brightness of each pixel, rows from the top: 0 is black and 1 white, float64 of shape (H, W).

    ``colour`` is the mean of the colour channels; ``alpha`` tells how opaque a pixel is, or is None where an image
    has no such channel.
    """

    colour: FloatArray
    alpha: FloatArray | None


def decode_image(data: bytes, most_pixels: int = MOST_CELLS) -> Shades:
    """Decode a PGM, PNG or BMP of 8 or 16 bits a channel.

    Raises ValueError, saying why, where the bytes are no such image, or one of more than ``most_pixels``.
    """
    if data.startswith(_LFS_POINTER):
        raise ValueError("a Git LFS pointer, not the image itself; fetch it with `git lfs pull`")
    size = _size(data)
    if size is not None:
        check_size(*size, most_pixels)
    pixels = _pixels(data) if size is not None and is_whole(data) else None
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{len(data)} bytes that do not decode; expected a PGM, PNG or BMP of 8 or 16 bits a channel")
    shades = pixels / _white(data, pixels)
    if shades.ndim == 2:
        return Shades(shades, None)
    return Shades(shades[..., :3].mean(axis=2), shades[..., 3] if shades.shape[2] == 4 else None)


def _size(data: bytes) -> tuple[int, int] | None:
    """Return width and height as the header of an image tells them; None where it is none that is read."""
    if header := _PIXMAP.match(data) or _BITMAP.match(data):
        return int(header[2]), int(header[3])
    if data.startswith(_PNG):
        return size_of(data)
    if data.startswith(b"BM") and len(data) >= 26:
        wide = struct.unpack_from("<I", data, 14)[0] >= 40  # else the header of OS/2
        width, height = struct.unpack_from("<ii" if wide else "<HH", data, 18)
        return abs(width), abs(height)
    return None


def _pixels(data: bytes) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    try:
        import cv2  # noqa: PLC0415 - maps that are not read from images do without
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("images are read by OpenCV: pip install 'dynpf[vision]'", name="cv2") from error
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)  # type: ignore[return-value]
    except cv2.error:  # no bytes at all, or more pixels than OpenCV takes
        return None


def _white(data: bytes, pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> int:
    """Return the value of white. OpenCV stretches only pixmaps that are written as text and have 8 bits."""
    full = int(np.iinfo(pixels.dtype).max)
    header = _PIXMAP.match(data)
    if not header or (header[1] in b"23" and pixels.dtype == np.uint8):
        return full
    return int(header[4])
