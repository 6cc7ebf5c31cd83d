"""The largest map: what would have more cells is refused before it takes memory."""

import struct

import pytest

from dynpf.maps import SegmentMap, decode_bitmap
from dynpf.maps.image import decode_image
from dynpf.maps.occupancy import MOST_CELLS

PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"


@pytest.mark.parametrize(
    "data",
    [
        b"P5\n40000 40000\n255\n",
        b"P2 # drawn\n999999999 2\n255\n",
        b"P4\n40000 40000\n",
        PNG + struct.pack(">II", 40_000, 40_000),
        b"BM" + bytes(12) + struct.pack("<Iii", 40, 40_000, -40_000),
        b"BM" + bytes(12) + struct.pack("<IHHI", 12, 40_000, 40_000, 0),
    ],
    ids=["pgm", "text", "pbm", "png", "bmp", "os/2"],
)
def test_an_image_of_too_many_pixels_is_refused_by_its_header(data: bytes) -> None:
    with pytest.raises(ValueError, match=f"cells; expected at most {MOST_CELLS}"):
        decode_image(data)


def test_segments_far_apart_make_no_grid() -> None:
    far = SegmentMap([[0.0, 0.0, 1e4, 1e4]])
    with pytest.raises(ValueError, match=f"a map of 200001 x 200001 cells; expected at most {MOST_CELLS}"):
        far.rasterize(0.05)
    with pytest.raises(ValueError, match="cells; expected at most"):
        SegmentMap([[0.0, 0.0, 1e300, 1.0]]).rasterize(0.05)


def test_walls_upon_walls_are_bounded_too() -> None:
    with pytest.raises(ValueError, match="walls over 1800 cells; expected at most 1000"):
        SegmentMap([[0.0, 0.0, 9.0, 0.0]] * 20).rasterize(0.1, most_cells=1000)


def test_a_map_of_as_many_cells_as_allowed_is_made() -> None:
    assert SegmentMap([[0.0, 0.0, 9.0, 9.0]]).rasterize(1.0, most_cells=100).cells.shape == (10, 10)
    with pytest.raises(ValueError, match="10 x 10 cells; expected at most 99"):
        SegmentMap([[0.0, 0.0, 9.0, 9.0]]).rasterize(1.0, most_cells=99)
    assert decode_bitmap(b"P5\n2 1\n255\n\0\xff", "drawn").cells.tolist() == [[1, 0]]
