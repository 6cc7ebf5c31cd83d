"""Files in recordings: large ones are compressed, and what does not unpack to what it claims is told."""

import hashlib
import json
import struct

import msgspec
import numpy as np
import pytest
import zstandard
from dynpf_formats.recording import attachments
from dynpf_formats.recording.attachments import COMPRESSED, attached, changed_files, files_of
from dynpf_formats.recording.errors import RecordingError

LARGE = np.random.default_rng(1).integers(0, 4, attachments.LARGEST_PLAIN + 1, dtype=np.uint8).tobytes()


def scenario(data: bytes) -> str:
    return json.dumps({"files": {"map.pgm": {"sha256": hashlib.sha256(data).hexdigest()}}})


def test_a_large_file_is_compressed_and_comes_back() -> None:
    small, large = attached("map.pgm", LARGE[1:]), attached("map.pgm", LARGE)
    assert (small.media_type, small.data) == ("image/x-portable-graymap", LARGE[1:])
    assert large.media_type == COMPRESSED
    assert len(large.data) < len(LARGE) / 2
    assert files_of([large]) == {"map.pgm": LARGE}
    assert changed_files(scenario(LARGE), [large]) == []
    assert "is not the one of the run" in changed_files(scenario(LARGE[1:]), [large])[0]


def claiming(size: int) -> bytes:
    """Return a frame of a kilobyte that claims ``size`` bytes."""
    frame = bytearray(zstandard.ZstdCompressor().compress(bytes(1024) * 1024))
    assert frame[4] & 0xC0 == 0x80  # the content's size takes four bytes
    struct.pack_into("<I", frame, 5 if frame[4] & 0x20 else 6, size)
    return bytes(frame)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"no frame", "cannot be unpacked"),
        (claiming(2**31), "claims 2147483648 bytes; expected 1 to 268435456"),
        (claiming(2**21), "cannot be unpacked|ends before the 2097152 bytes that it claims"),
        (zstandard.ZstdCompressor().compress(b"x" * 4096)[:-2], "cannot be unpacked|ends before the 4096 bytes"),
        (zstandard.ZstdCompressor(write_content_size=False).compress(b"x"), "claims 18446744073709551615 bytes"),
    ],
)
def test_what_does_not_unpack_to_what_it_claims_is_told(data: bytes, expected: str) -> None:
    broken = msgspec.structs.replace(attached("map.pgm", b""), media_type=COMPRESSED, data=data)
    with pytest.raises(RecordingError, match=rf"attachment 'files/map\.pgm': .*({expected})"):
        files_of([broken])
    (text,) = changed_files(scenario(b""), [broken])
    assert text.startswith("attachment 'files/map.pgm': ")
