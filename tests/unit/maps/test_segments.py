"""Segments: polar forms in closed form and in any frame, and the cells they run through."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dynpf.maps import SegmentMap
from dynpf.maps.segments import polar_form, polar_in_frame

HALF = math.sqrt(0.5)
COORDINATE = st.floats(-20, 20)
SEGMENT = st.tuples(COORDINATE, COORDINATE, COORDINATE, COORDINATE)
POSE = st.tuples(COORDINATE, COORDINATE, st.floats(-10, 10))


@pytest.mark.parametrize(
    ("segment", "rho", "alpha"),
    [
        ((2, -1, 2, 1), 2.0, 0.0),
        ((-1, 3, 1, 3), 3.0, math.pi / 2),
        ((-2, -1, -2, 1), 2.0, math.pi),
        ((-1, -3, 1, -3), 3.0, -math.pi / 2),
        ((1, 0, 0, 1), HALF, math.pi / 4),
        ((-1, 0, 0, -1), HALF, -3 * math.pi / 4),
        ((5, 1, 7, 1), 1.0, math.pi / 2),  # the perpendicular's foot lies outside the segment
    ],
)
def test_a_line_is_its_distance_and_the_direction_to_it(segment: tuple[float, ...], rho: float, alpha: float) -> None:
    x1, y1, x2, y2 = segment
    walls = SegmentMap([segment, (x2, y2, x1, y1)])
    assert walls.rho == pytest.approx([rho, rho])
    assert walls.alpha == pytest.approx([alpha, alpha])
    assert walls.lengths == pytest.approx([math.hypot(x2 - x1, y2 - y1)] * 2)


@pytest.mark.parametrize(
    ("pose", "rho", "alpha"),
    [
        ((0, 0, math.pi / 2), 2.0, -math.pi / 2),
        ((1.5, 7, 0), 0.5, 0.0),
        ((3, 0, 0), 1.0, math.pi),  # beyond the line
        ((3, 0, math.pi), 1.0, 0.0),
        ((0, 0, -math.pi), 2.0, math.pi),  # pi, never -pi
        ((0, 0, math.pi), 2.0, math.pi),
    ],
)
def test_a_pose_sees_a_line_from_where_it_is(pose: tuple[float, ...], rho: float, alpha: float) -> None:
    seen = SegmentMap([(2, -1, 2, 1)]).seen_from(np.array([pose]).T)
    assert (seen[0].item(), seen[1].item()) == pytest.approx((rho, alpha))


@given(SEGMENT, POSE)
def test_the_form_in_a_frame_is_that_of_the_segment_in_that_frame(
    segment: tuple[float, ...], pose: tuple[float, float, float]
) -> None:
    ends = np.array(segment).reshape(2, 2)
    assume(np.hypot(*(ends[1] - ends[0])) > 1e-3)
    x, y, theta = pose
    to_frame = np.array([[math.cos(theta), math.sin(theta)], [-math.sin(theta), math.cos(theta)]])
    moved = ((ends - (x, y)) @ to_frame.T).reshape(1, 4)
    rho, alpha = polar_in_frame(*polar_form(np.array([segment])), np.array([[x], [y], [theta]]))
    expected_rho, expected_alpha = polar_form(moved)
    assert rho >= 0
    assert -math.pi < alpha <= math.pi
    # Compared as the feet of the perpendiculars and as undirected normals: neither minds which form rho = 0 takes.
    assert rho * np.exp(1j * alpha) == pytest.approx(expected_rho * np.exp(1j * expected_alpha), abs=1e-9)
    assert np.exp(2j * alpha) == pytest.approx(np.exp(2j * expected_alpha), abs=1e-9)


def test_all_lines_are_seen_from_all_poses() -> None:
    walls = SegmentMap([(2, -1, 2, 1), (-1, 3, 1, 3)])
    rho, alpha = walls.seen_from(np.zeros((3, 5)))
    assert rho.shape == alpha.shape == (2, 5)
    assert np.array_equal(rho[:, 4], walls.rho)


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ([], r"segments of shape \(0,\); expected \(S, 4\)"),
        ([[1.0, 2.0]], r"segments of shape \(1, 2\)"),
        ([[0, 0, 1, 0], [0, 0, 1, math.nan]], r"segment 1 is \[0.0, 0.0, 1.0, nan\]; expected finite metres"),
        ([[0, 0, 1, 0], [3, 4, 3, 4]], r"segment 1 is \[3.0, 4.0, 3.0, 4.0\]; expected two different ends"),
    ],
)
def test_what_is_no_segment_is_refused(segments: list[list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SegmentMap(segments)


def test_the_walls_of_a_room_close_it() -> None:
    room = SegmentMap([(0.5, 0.5, 3.5, 0.5), (3.5, 0.5, 3.5, 2.5), (3.5, 2.5, 0.5, 2.5), (0.5, 2.5, 0.5, 0.5)])
    grid = room.rasterize(1.0, margin=0.5)
    assert grid.origin == (0.0, 0.0, 0.0)
    assert grid.occupied[:3, :4].astype(int).tolist() == [[1, 1, 1, 1], [1, 0, 0, 1], [1, 1, 1, 1]]
    assert not grid.occupied[3:].any()
    assert not grid.occupied[:, 4:].any()


def test_a_slanting_wall_takes_every_cell_it_runs_through() -> None:
    grid = SegmentMap([(0.0, 0.0, 4.0, 2.0), (0.0, 0.0, 0.0, 0.5)]).rasterize(1.0)
    assert grid.occupied[:2, :4].astype(int).tolist() == [[1, 1, 0, 0], [0, 0, 1, 1]]


@given(SEGMENT, st.floats(0.05, 3), st.floats(0, 2), st.floats(0, 1))
def test_every_point_of_a_segment_lies_in_or_next_to_a_wall(
    segment: tuple[float, ...], resolution: float, margin: float, share: float
) -> None:
    x1, y1, x2, y2 = segment
    assume(math.hypot(x2 - x1, y2 - y1) > 1e-3)
    grid = SegmentMap([segment]).rasterize(resolution, margin)
    column, row = grid.to_cells(x1 + share * (x2 - x1), y1 + share * (y2 - y1))
    # Within rounding of a cell: all cells that the point could be said to lie in.
    rows, columns = np.floor(row + np.array([-1e-9, 1e-9])), np.floor(column + np.array([-1e-9, 1e-9]))
    inside = [(int(r), int(c)) for r in rows for c in columns if r < len(grid.cells) and c < grid.cells.shape[1]]
    assert any(grid.occupied[cell] for cell in inside)


@pytest.mark.parametrize(("resolution", "margin"), [(0.0, 0.0), (math.nan, 0.0), (1.0, -1.0), (1.0, math.inf)])
def test_a_grid_needs_a_cell_size_and_a_margin(resolution: float, margin: float) -> None:
    with pytest.raises(ValueError, match=r"(resolution|margin) = .*; expected metres"):
        SegmentMap([(0, 0, 1, 1)]).rasterize(resolution, margin)
