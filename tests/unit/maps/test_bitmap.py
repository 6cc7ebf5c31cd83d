"""Drawings as maps."""

import cv2
import numpy as np
import pytest

from dynpf.maps import OccupancyGrid, decode_bitmap, from_grey

GREY = np.array([[0, 255, 127], [255, 255, 128], [255, 255, 255]], dtype=np.uint8)


def drawn(grid: OccupancyGrid) -> list[list[int]]:
    """The walls as on paper, top row first."""
    rows: list[list[int]] = grid.occupied[::-1].astype(int).tolist()
    return rows


def test_dark_pixels_are_walls_and_the_lowest_row_comes_first() -> None:
    grid = from_grey(GREY)
    assert drawn(grid) == [[1, 0, 1], [0, 0, 0], [0, 0, 0]]
    assert grid.occupied[2, 0]
    assert grid.free.sum() == 7
    assert drawn(from_grey(GREY, free_from=255)) == [[1, 0, 1], [0, 0, 1], [0, 0, 0]]


def test_thick_walls_are_those_that_colon_hits() -> None:
    thick = from_grey(GREY, free_from=255, thicken=True)
    assert drawn(thick) == [[1, 1, 1], [1, 1, 1], [0, 1, 1]]


def test_with_the_origin_half_a_pixel_off_pixels_have_whole_coordinates() -> None:
    grid = from_grey(GREY, origin=(-0.5, -0.5, 0.0))
    column, row = grid.to_cells(np.array([0.0, -0.49, 0.49]), np.array([2.0, 1.51, 2.49]))
    assert grid.occupied[np.floor(row).astype(int), np.floor(column).astype(int)].all()


@pytest.mark.parametrize("ending", [".png", ".bmp", ".pgm"])
def test_encoded_drawings_are_read(ending: str) -> None:
    data = cv2.imencode(ending, GREY)[1].tobytes()
    grid = decode_bitmap(data, "tube", resolution=0.1, free_from=255)
    assert np.array_equal(grid.cells, from_grey(GREY, free_from=255).cells)
    assert grid.resolution == 0.1


def test_colours_count_as_their_mean() -> None:
    pixel = np.array([[[255, 0, 0], [255, 255, 0]]], dtype=np.uint8)
    assert drawn(decode_bitmap(cv2.imencode(".png", pixel)[1].tobytes(), "tube")) == [[1, 0]]


def test_what_is_no_image_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"tube\.png: 7 bytes that do not decode; expected a PGM, PNG or BMP"):
        decode_bitmap(b"nothing", "tube.png")
