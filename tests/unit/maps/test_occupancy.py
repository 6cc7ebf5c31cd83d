"""The occupancy grid: what it refuses, where its cells lie, and samples of its free area."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynpf.maps import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.occupancy import faces, thickened
from dynpf.rng import Stream

CELLS = np.array([[FREE, OCCUPIED, UNKNOWN], [FREE, FREE, OCCUPIED]], dtype=np.uint8)
STREAM = Stream.of(7, "test", 0)


def test_cells_divide_into_free_occupied_and_unknown() -> None:
    grid = OccupancyGrid(CELLS, 0.5)
    assert grid.occupied.tolist() == [[False, True, False], [False, False, True]]
    assert grid.free.tolist() == [[True, False, False], [True, True, False]]
    assert grid.size_m == (1.5, 1.0)
    assert np.array_equal(OccupancyGrid.from_bools(grid.occupied, 0.5).occupied, grid.occupied)
    assert not (OccupancyGrid.from_bools(grid.occupied, 0.5).cells == UNKNOWN).any()


def test_a_grid_stays_as_it_was_made() -> None:
    given_cells = CELLS.copy()
    grid = OccupancyGrid(given_cells, 1.0)
    given_cells[:] = OCCUPIED
    assert np.array_equal(grid.cells, CELLS)
    with pytest.raises(ValueError, match="read-only"):
        grid.cells[0, 0] = OCCUPIED


@pytest.mark.parametrize(
    ("cells", "resolution", "origin", "message"),
    [
        (CELLS.astype(int), 1.0, (0, 0, 0), r"cells is int64 of shape \(2, 3\); expected a uint8 array \(H, W\)"),
        (CELLS[0], 1.0, (0, 0, 0), r"cells is uint8 of shape \(3,\)"),
        (CELLS[:0], 1.0, (0, 0, 0), r"cells is uint8 of shape \(0, 3\); .* at least one cell"),
        (CELLS.tolist(), 1.0, (0, 0, 0), "cells is list"),
        (CELLS + np.uint8(1), 1.0, (0, 0, 0), r"cells\[0, 2\] = 3; expected 0 \(free\), 1"),
        (CELLS, 0.0, (0, 0, 0), "resolution = 0.0; expected metres a cell, finite and above 0"),
        (CELLS, math.nan, (0, 0, 0), "resolution = nan"),
        (CELLS, math.inf, (0, 0, 0), "resolution = inf"),
        (CELLS, 1.0, (0.0, math.nan, 0.0), r"origin = \(0.0, nan, 0.0\); expected x, y in metres and yaw"),
        (CELLS, 1.0, (0.0, 0.0), r"origin = \(0.0, 0.0\)"),
    ],
)
def test_what_is_no_grid_is_refused(cells: object, resolution: float, origin: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OccupancyGrid(cells, resolution, origin)  # type: ignore[arg-type]


def test_a_turned_origin_turns_the_cells_about_it() -> None:
    grid = OccupancyGrid(CELLS, 0.5, (10.0, 20.0, math.pi / 2))
    # Along the grid's x, which points along the map's y.
    assert np.allclose(grid.to_map(3.0, 0.0), (10.0, 21.5))
    assert np.allclose(grid.to_map(0.0, 2.0), (9.0, 20.0))


@given(
    st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-10, 10)),
    st.floats(0.001, 10),
    st.floats(-1000, 1000),
    st.floats(-1000, 1000),
)
def test_cells_and_map_convert_both_ways(
    origin: tuple[float, float, float], resolution: float, column: float, row: float
) -> None:
    grid = OccupancyGrid(CELLS, resolution, origin)
    assert np.allclose(grid.to_cells(*grid.to_map(column, row)), (column, row), rtol=0, atol=1e-9 + 1e-12 / resolution)


def test_samples_are_uniform_over_the_free_area_and_all_headings() -> None:
    grid = OccupancyGrid(CELLS, 0.5, (1.0, -2.0, 0.4))
    poses = grid.sample_free(30_000, STREAM)
    assert poses.dtype == np.float32
    column, row = grid.to_cells(poses[0], poses[1])
    counts = np.histogram2d(row, column, bins=(2, 3), range=((0, 2), (0, 3)))[0]
    # Three free cells: 10000 each, five standard deviations about it.
    assert np.abs(counts - 10_000 * grid.free).max() < 5 * math.sqrt(30_000 * 2 / 9)
    for rest in (column % 1, row % 1, (poses[2] + math.pi) / (2 * math.pi)):
        assert np.histogram(rest, 10, (0, 1))[0] == pytest.approx(3_000, abs=5 * math.sqrt(30_000 * 0.09))


def test_a_particle_starts_where_it_does_whatever_the_batches() -> None:
    grid = OccupancyGrid(CELLS, 0.5)
    whole = grid.sample_free(20, STREAM)
    parts = [grid.sample_free(8, STREAM), grid.sample_free(12, STREAM.starting_at(8))]
    assert np.array_equal(np.concatenate(parts, axis=1), whole)


def test_a_map_of_more_cells_than_a_uniform_number_has_values_is_sampled_everywhere() -> None:
    # 2**25 free cells: with 24 bits, only every second column would ever be chosen.
    grid = OccupancyGrid(np.zeros((2**10, 2**15), dtype=np.uint8), 1.0)
    column = np.floor(grid.sample_free(400, STREAM)[0]).astype(int)
    assert np.bincount(column % 2, minlength=2) == pytest.approx(200, abs=50)


def test_clearance_keeps_every_sample_away_from_walls() -> None:
    occupied = np.zeros((9, 9), dtype=bool)
    occupied[4, 4] = True
    grid = OccupancyGrid.from_bools(occupied, 1.0)
    poses = grid.sample_free(5_000, STREAM, clearance=2.0)
    gap = np.hypot(*(np.maximum(np.abs(poses[:2] - 4.5) - 0.5, 0.0)))
    assert 2.0 <= gap.min() < 2.1
    assert np.hypot(*(grid.sample_free(5_000, STREAM)[:2] - 4.5)).min() < 1.0


def test_no_place_to_start_from_is_said() -> None:
    with pytest.raises(ValueError, match="no free cell in a grid of 1 x 1 cells"):
        OccupancyGrid(np.array([[UNKNOWN]], dtype=np.uint8), 1.0).sample_free(1, STREAM)
    with pytest.raises(ValueError, match=r"no free cell 3\.0 m away from every wall in a grid of 3 x 2 cells"):
        OccupancyGrid(CELLS, 1.0).sample_free(1, STREAM, clearance=3.0)


@pytest.mark.parametrize("clearance", [-0.1, math.nan])
def test_a_clearance_is_a_distance(clearance: float) -> None:
    with pytest.raises(ValueError, match=f"clearance = {clearance}; expected metres, not negative"):
        OccupancyGrid(CELLS, 1.0).sample_free(1, STREAM, clearance)


def test_the_faces_of_walls_are_where_free_space_touches_them() -> None:
    drawn = ["..##u", "..##u", ".####", "u#uuu"]
    cells = np.array([[".#u".index(mark) for mark in row] for row in drawn], dtype=np.uint8)
    grid = OccupancyGrid(cells, 0.1)
    seen = ["..#..", "..#..", ".#...", "....."]
    assert faces(grid.occupied, grid.free).tolist() == [[mark == "#" for mark in row] for row in seen]
    hidden = np.where(cells == FREE, np.uint8(UNKNOWN), cells)
    assert np.array_equal(faces(hidden == OCCUPIED, hidden == FREE), grid.occupied)


def test_thick_walls_take_in_their_eight_neighbours() -> None:
    walls = np.zeros((4, 5), dtype=bool)
    walls[0, 0] = walls[2, 4] = True
    assert thickened(walls).astype(int).tolist() == [[1, 1, 0, 0, 0], [1, 1, 0, 1, 1], [0, 0, 0, 1, 1], [0, 0, 0, 1, 1]]
