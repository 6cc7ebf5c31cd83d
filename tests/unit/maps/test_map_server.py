"""The maps of ROS: pixels to cells in each mode, and errors that tell what is wrong with a file."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from dynpf.maps import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.map_server import decode

DATA = Path(__file__).parents[3] / "../shared/data"
KEYS = {
    "image": "m.pgm",
    "resolution": "0.05",
    "origin": "[1.0, -2.0, 0.5]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}
GREY = np.array([[0, 89, 90], [205, 206, 255]], dtype=np.uint8)
# Darkness 1, 0.651, 0.647 above 0.196, 0.192, 0 below; the rows from the lowest.
CELLS = [[UNKNOWN, FREE, FREE], [OCCUPIED, OCCUPIED, UNKNOWN]]


def text(**changes: str | None) -> str:
    return "".join(f"{key}: {value}\n" for key, value in (KEYS | changes).items() if value is not None)


def decoded(image: bytes | NDArray[np.integer[Any]], /, **changes: str | None) -> OccupancyGrid:
    data = image if isinstance(image, bytes) else cv2.imencode(".png", image)[1].tobytes()
    return decode(text(**changes), {"m.pgm": data}.__getitem__, "map.yaml")


def test_pixels_become_cells_from_the_lowest_row_up() -> None:
    grid = decoded(GREY)
    assert grid.cells.tolist() == CELLS
    assert grid.resolution == 0.05
    assert grid.origin == (1.0, -2.0, 0.5)


@pytest.mark.parametrize("negate", ["1", "true"])
def test_a_negated_map_has_white_walls(negate: str) -> None:
    assert decoded(255 - GREY, negate=negate).cells.tolist() == CELLS


@pytest.mark.parametrize(
    "data",
    [
        b"P5 3 2 255\n" + GREY.tobytes(),
        b"P5\n# made by hand\n3 2\n51\n" + bytes([0, 17, 18, 41, 42, 51]),
        b"P5 3 2 1000\n" + np.array([0, 340, 360, 800, 810, 1000], dtype=">u2").tobytes(),
        b"P2 3 2 51 0 17 18 41 42 51\n",
        b"P2 3 2 1000 0 340 360 800 810 1000\n",
    ],
)
def test_white_is_whatever_a_pixmap_says_it_is(data: bytes) -> None:
    # 17/51 is darker than 0.65 and 18/51 is not; 41/51 and 42/51 lie on both sides of a lightness of 0.804.
    assert decoded(data).cells.tolist() == CELLS


def test_images_of_sixteen_bits_are_read_as_those_of_eight() -> None:
    assert decoded(GREY.astype(np.uint16) * 257).cells.tolist() == CELLS


def test_colours_are_averaged() -> None:
    pixels = np.array([[[0, 0, 0], [255, 0, 0], [255, 255, 255], [255, 255, 0]]], dtype=np.uint8)
    assert decoded(pixels).cells.tolist() == [[OCCUPIED, OCCUPIED, FREE, UNKNOWN]]


def test_alpha_counts_as_a_channel_of_a_trinary_map_and_hides_pixels_of_a_scaled_one() -> None:
    colours, alphas = np.array([0, 0, 255, 255, 128]), np.array([255, 0, 255, 0, 255])
    pixels = np.stack([colours, colours, colours, alphas], axis=-1)[None].astype(np.uint8)
    assert decoded(pixels).cells.tolist() == [[OCCUPIED, OCCUPIED, FREE, UNKNOWN, UNKNOWN]]
    assert decoded(pixels, mode="scale").cells.tolist() == [[OCCUPIED, UNKNOWN, FREE, UNKNOWN, UNKNOWN]]
    # 0.25 of an opaque black pixel's mean is its alpha: here that alone makes it no wall.
    strict = {"occupied_thresh": "0.8"}
    assert decoded(pixels, **strict).cells[0, 0] == UNKNOWN
    assert decoded(pixels, mode="scale", **strict).cells[0, 0] == OCCUPIED


def test_a_raw_map_holds_percent() -> None:
    grid = decoded(np.array([[0, 19, 20, 65, 66, 100, 101, 255]], dtype=np.uint8), mode="raw", negate="1")
    expected = [FREE, FREE, UNKNOWN, UNKNOWN, OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN]
    assert grid.cells.tolist() == [expected]


def test_numbers_without_a_point_and_further_keys_are_taken() -> None:
    assert decoded(GREY, resolution="5e-2", map_type="occupancy").resolution == 0.05


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": None}, "map.yaml: image is missing; a map_server file must state it"),
        ({"image": "7"}, "map.yaml: image = 7; expected the path of an image"),
        ({"image": "other.pgm"}, "map.yaml: image = 'other.pgm' cannot be read: not found"),
        ({"resolution": "0"}, "map.yaml: resolution = 0; expected metres a pixel, above 0"),
        ({"resolution": "true"}, "map.yaml: resolution = True; expected a finite number"),
        ({"resolution": "five"}, "map.yaml: resolution = 'five'; expected a finite number"),
        (
            {"origin": "[0.0, .nan, 0.0]"},
            "map.yaml: origin = [0.0, nan, 0.0]; expected [x, y, yaw], three finite numbers in metres and radians",
        ),
        ({"origin": "[nan, 0, 0]"}, "map.yaml: origin = ['nan', 0, 0]; expected [x, y, yaw]"),
        ({"origin": "[0, 0]"}, "map.yaml: origin = [0, 0]; expected [x, y, yaw]"),
        ({"origin": "{x: 0}"}, "map.yaml: origin = a mapping; expected [x, y, yaw]"),
        ({"origin": "[[1], 2, 3, 4, 5]"}, "map.yaml: origin = [[...], 2, 3, 4, ...]; expected [x, y, yaw]"),
        ({"negate": "2"}, "map.yaml: negate = 2; expected 0 or 1"),
        ({"free_thresh": "-0.1"}, "map.yaml: free_thresh = -0.1; expected a share between 0 and 1"),
        ({"occupied_thresh": "65"}, "map.yaml: occupied_thresh = 65; expected a share between 0 and 1"),
        ({"free_thresh": "0.7"}, "map.yaml: free_thresh = 0.7; expected no more than occupied_thresh, which is 0.65"),
        ({"mode": "ternary"}, "map.yaml: mode = 'ternary'; expected one of trinary, scale, raw"),
        ({"negate": "[0"}, "map.yaml, line 5: not YAML: expected ',' or ']', but got"),
    ],
)
def test_a_wrong_key_is_named_with_its_value(changes: dict[str, str | None], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        decoded(GREY, **changes)
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("yaml_text", "message"),
    [
        ("", "map.yaml: holds None; expected the keys of a map_server file"),
        ("just words", "map.yaml: holds 'just words'; expected the keys"),
        ("image: 2001-99-99", "map.yaml: not YAML: month must be in 1..12"),
        ("[" * 1000, "map.yaml: not YAML: maximum recursion depth exceeded"),
        ("a: [" + "1, " * 30_000 + "]", "map.yaml: 90005 characters; a map_server file has at most 65536"),
        ("a: \0", "map.yaml: not YAML: unacceptable character #x0000"),
    ],
)
def test_what_is_no_map_file_is_refused(yaml_text: str, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        decode(yaml_text, dict[str, bytes]().__getitem__, "map.yaml")
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "map.yaml: image = 'm.pgm' is 0 bytes that do not decode; expected a PGM, PNG or BMP of 8 or 16 bits"),
        (b"no image", "map.yaml: image = 'm.pgm' is 8 bytes that do not decode"),
        (b"P5 200000 200000 255\n", "map.yaml: image = 'm.pgm' is a map of 200000 x 200000 cells; expected at most 2"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:12\nsize 9\n",
            "map.yaml: image = 'm.pgm' is a Git LFS pointer, not the image itself; fetch it with `git lfs pull`",
        ),
    ],
)
def test_what_is_no_image_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        decoded(data)
    assert str(raised.value).startswith(message)


def test_a_file_that_cannot_be_opened_is_named_with_the_reason() -> None:
    def missing(path: str) -> bytes:
        raise FileNotFoundError(2, "No such file or directory", path)

    with pytest.raises(ValueError, match=r"map\.yaml: image = 'm\.pgm' cannot be read: no such file or directory"):
        decode(text(), missing, "map.yaml")


@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is absent")
@pytest.mark.parametrize(
    ("file", "shape", "walls"),
    [
        ("maps/nav2/TenByTen.yaml", (10, 10), 20),
        ("maps/nav2/depot.yaml", (307, 604), 5947),
        ("maps/nav2/map_circular.yaml", (384, 384), 920),
        ("maps/nav2/tb3_sandbox.yaml", (384, 384), 870),
        ("maps/turtlebot3/map.yaml", (384, 384), 795),
        ("bags/uob_pioneer/meeting.yaml", (602, 602), 6020),
        ("bags/drl/i-108_10mm.yaml", (765, 2051), 6428),
    ],
)
def test_maps_of_others_are_read(file: str, shape: tuple[int, int], walls: int) -> None:
    path = DATA / file
    grid = decode(path.read_text(), lambda image: (path.parent / image).read_bytes(), file)
    assert grid.cells.shape == shape
    assert grid.occupied.sum() == walls


@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is absent")
@pytest.mark.parametrize("file", ["invalid_image.yaml", "testmap.yaml"])
def test_broken_maps_of_others_say_what_is_missing(file: str) -> None:
    path = DATA / "maps/nav2" / file
    with pytest.raises(ValueError, match=rf"{file}: image = '\w+\.png' cannot be read: no such file or directory"):
        decode(path.read_text(), lambda image: (path.parent / image).read_bytes(), file)
