"""Walls put together from pieces that scans showed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynpf.maps.line_map import LineMapParams, line_map, placed
from dynpf.maps.segments import polar_form, polar_in_frame
from dynpf.measurement.lines import Lines

ONE = LineMapParams(sightings=1)


@given(x=st.floats(-5, 5), y=st.floats(-5, 5), theta=st.floats(-3, 3), turn=st.floats(-3, 3))
def test_a_line_seen_from_a_pose_is_placed_where_it_was(x: float, y: float, theta: float, turn: float) -> None:
    # A wall of 2 m whose middle is at (3, 1): its polar form from the pose, by the segment map's own functions.
    wall = np.array([[3 - math.cos(turn), 1 - math.sin(turn), 3 + math.cos(turn), 1 + math.sin(turn)]])
    rho, alpha = polar_in_frame(*polar_form(wall), np.array([x, y, theta]))
    normal = alpha + theta
    middle = (3 - x) * -np.sin(normal) + (1 - y) * np.cos(normal)
    (found,) = placed(Lines(rho, alpha, np.array([2.0]), middle), np.array([x, y, theta]))
    ends = sorted([found[:2].tolist(), found[2:].tolist()])
    np.testing.assert_allclose(ends, sorted([wall[0, :2].tolist(), wall[0, 2:].tolist()]), atol=1e-6)


def test_pieces_of_one_wall_become_one_and_others_stay_apart() -> None:
    first = np.array([[0.0, 0.0, 3.0, 0.0], [0.0, 1.0, 2.0, 1.0]])
    second = np.array([[4.5, 0.02, 2.9, 0.0], [5.5, 0.0, 6.5, 0.0]])  # the last begins 1 m after the others' end
    walls = line_map([first, second], ONE)
    assert walls.segments == pytest.approx(np.array([[0, 0, 4.5, 0], [0, 1, 2, 1], [5.5, 0, 6.5, 0]]), abs=1e-6)


def test_a_wall_seen_too_seldom_is_none() -> None:
    wall, stray = np.array([[0.0, 0.0, 3.0, 0.0]]), np.array([[0.0, 2.0, 1.0, 3.0]])
    assert len(line_map([wall, wall, stray], LineMapParams(sightings=2))) == 1
    with pytest.raises(ValueError, match="segments of shape"):
        line_map([stray], LineMapParams(sightings=2))


def test_lines_without_middles_have_no_place() -> None:
    with pytest.raises(ValueError, match="no place"):
        placed(Lines(np.ones(1), np.ones(1), np.ones(1)), np.zeros(3))
