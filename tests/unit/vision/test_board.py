"""The calibration board: found however it lies and however the lens bends it."""

import math

import numpy as np
import pytest
from dynpf_systems.parts.camera_model import CameraParams, project

from dynpf import rng
from dynpf.vision import Board, CalibrationError, Disc, calibrate, find_board

BOARD = Board()


def discs_of(camera: CameraParams, board: Board = BOARD) -> list[Disc]:
    """The board's dots as they would be found, in no order."""
    dots = np.array(board.dots())
    px = project(dots[:, :2], camera)
    found = [Disc(x, y, 400 * radius, -90.0, 0.0, 1.0) for (x, y), radius in zip(px.tolist(), dots[:, 2], strict=True)]
    return [found[i] for i in rng.generator(2, "test", 0).permutation(len(found))]


@pytest.mark.parametrize("turn", [0.0, 0.7, math.pi / 2, 3.0])
@pytest.mark.parametrize("distortion", [-0.2, 0.0, 0.2])
def test_every_dot_gets_its_place(turn: float, distortion: float) -> None:
    camera = CameraParams(rotation_rad=turn, radial_distortion=distortion, tilt_x_rad=0.1)
    px, metres = find_board(discs_of(camera), BOARD)
    assert len(px) == 49
    assert px == pytest.approx(project(metres, camera), abs=1e-9)
    assert calibrate(px, metres).projection.to_pixels(metres) == pytest.approx(px, abs=1e-2)


def test_dots_may_be_hidden_and_other_discs_lie_about() -> None:
    camera = CameraParams(radial_distortion=-0.15)
    seen = [disc for disc in discs_of(camera) if not (disc.radius_px < 20 and disc.x_px > 950)]
    stray = Disc(700.0, 560.0, 10.0, -90.0, 0.0, 1.0)
    px, metres = find_board([*seen, stray], BOARD)
    assert len(px) == len(seen) < 49
    assert px == pytest.approx(project(metres, camera), abs=1e-9)


@pytest.mark.parametrize("count", [0, 3, 24])
def test_refuses_what_is_no_board(count: int) -> None:
    with pytest.raises(CalibrationError, match="too few for a board of 49 dots"):
        find_board(discs_of(CameraParams())[:count], BOARD)


def test_refuses_discs_that_lie_in_no_grid() -> None:
    places = rng.generator(2, "test", 1).uniform(0, 1000, (40, 2))
    discs = [Disc(x, y, 5.0 + i, -90.0, 0.0, 1.0) for i, (x, y) in enumerate(places.tolist())]
    with pytest.raises(CalibrationError, match="need half of them"):
        find_board(discs, BOARD)
