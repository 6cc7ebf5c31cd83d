"""The size of an encoded image is known before it is decoded, and what claims more than it holds has none."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from dynpf.image_size import is_whole, size_of
from dynpf.maps.image import decode_image

IMAGE = np.arange(40 * 30, dtype=np.uint16).astype(np.uint8).reshape(30, 40)


def encoded(extension: str) -> bytes:
    return cv2.imencode(extension, IMAGE)[1].tobytes()


def part(kind: bytes, body: bytes, claimed: int | None = None) -> bytes:
    length = len(body) if claimed is None else claimed
    return struct.pack(">I", length) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


@pytest.mark.parametrize("extension", [".png", ".jpg"])
def test_the_size_is_that_of_the_decoded_image(extension: str) -> None:
    assert size_of(encoded(extension)) == (40, 30)


def test_a_part_that_claims_more_than_there_is_is_refused_before_memory_is_taken() -> None:
    sound = encoded(".png")
    header = sound[:33]
    assert is_whole(sound)
    for hostile in (header + part(b"IDAT", b"abc", 2**30), sound[:-1], sound[:20], header[:8] + sound[33:]):
        assert size_of(hostile) is None or not is_whole(hostile)
        with pytest.raises(ValueError, match="do not decode"):
            decode_image(hostile)
    assert decode_image(sound).colour.shape == (30, 40)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"\xff\xd8\xff\xe0\x00\x00\xff\xe0", b"GIF89a", encoded(".bmp")])
def test_other_bytes_have_no_size(data: bytes) -> None:
    assert size_of(data) is None
