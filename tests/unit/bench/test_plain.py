import numpy as np
import pytest
from dynpf_lab.bench import plain, works
from dynpf_lab.bench.floor_plan import floor_plan
from dynpf_lab.bench.problems import (
    RANGE_MAX_M,
    RANGE_MIN_M,
    SIGMA_BEARING,
    SIGMA_RANGE_M,
    LandmarkProblem,
    ScanProblem,
    movement,
)

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.likelihood_field import LikelihoodField
from dynpf.measurement.scan import Scan


def box(origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> OccupancyGrid:
    """Return a room of 4 m x 3 m inside walls of one cell, with 0.35 m of nothing around them."""
    occupied = np.zeros((76, 96), dtype=np.bool_)
    occupied[7:-7, 7:-7] = True
    occupied[8:-8, 8:-8] = False
    return OccupancyGrid.from_bools(occupied, 0.05, origin)


@pytest.fixture(scope="module")
def problem() -> ScanProblem:
    return ScanProblem(box((1.0, -2.0, 0.4)), 60)


def test_the_floor_plan_is_the_same_at_every_call_and_has_rooms() -> None:
    grid = floor_plan()
    assert grid.cells.shape == (700, 1000)
    np.testing.assert_array_equal(grid.cells, floor_plan().cells)
    assert 0.1 < grid.occupied.mean() < 0.25


def test_systematic_picks_what_the_teeth_of_the_comb_fall_on() -> None:
    weights = plain.normalized(np.random.default_rng(0).normal(0.0, 2.0, 500).astype(np.float32))
    teeth = (np.random.default_rng(1).random() + np.arange(500)) / 500
    expected = np.searchsorted(np.cumsum(weights, dtype=np.float64), teeth)
    np.testing.assert_array_equal(plain.systematic(weights, np.random.default_rng(1)), expected)


def test_rays_end_at_the_walls_of_a_room() -> None:
    angles = np.linspace(-3.0, 3.0, 200, dtype=np.float32)
    x, y = np.full(200, 1.5, dtype=np.float32), np.full(200, 1.0, dtype=np.float32)
    east = np.where(np.cos(angles) > 0.0, 4.4 - 1.5, 0.4 - 1.5) / np.cos(angles)
    north = np.where(np.sin(angles) > 0.0, 3.4 - 1.0, 0.4 - 1.0) / np.sin(angles)
    found = plain.Rays(box()).ranges(x, y, angles, 12.0)
    np.testing.assert_allclose(found, np.minimum(east, north), atol=0.04)
    assert plain.Rays(box()).ranges(x[:1], y[:1], angles[:1], 1.0)[0] == 1.0


def test_the_likelihood_field_is_ours(problem: ScanProblem) -> None:
    field = works.plain_field(problem.grid)
    poses = problem.anywhere(2000)
    scan = Scan(problem.angles, problem.ranges[0], RANGE_MIN_M, RANGE_MAX_M)
    ours = LikelihoodField(works.FIELD, problem.grid).log_likelihood(poses, scan)
    # An end that lies on the edge of a cell may be rounded into the next.
    off = np.abs(field.log_likelihood(poses, problem.angles, problem.ranges[0]) - ours)
    assert np.quantile(off, 0.9) < 1e-2
    assert np.ptp(ours) > 50.0


def test_the_landmark_likelihood_is_ours_up_to_a_constant() -> None:
    told = LandmarkProblem()
    work = works.Landmarks(told)
    poses = told.cloud(2000)
    baseline = plain.Landmarks(told.landmarks, SIGMA_RANGE_M, SIGMA_BEARING)
    off = baseline.log_likelihood(poses, told.ranges[0], told.bearings[0]) - work.model.log_likelihood(
        poses, work.readings[0]
    )
    np.testing.assert_allclose(off, off[0], atol=5e-2)


@pytest.mark.parametrize("name", ["likelihood_field_60", "beam_60", "kld"])
def test_an_update_with_a_scan_finds_the_robot(name: str, problem: ScanProblem) -> None:
    work = works.build(name, problem.grid, None)
    ours, numpy = work.ours(3000, 1), work.numpy(3000)
    for step in range(2):
        truth = problem.truth[step if name == "kld" else 0]
        for estimate in (ours().report.estimate.mean, numpy().estimate):
            assert np.hypot(*(np.asarray(estimate)[:2] - truth[:2])) < 0.1


def test_an_update_with_landmarks_goes_round_with_the_robot() -> None:
    told = LandmarkProblem()
    work = works.Landmarks(told)
    ours, numpy = work.ours(2000, 2), work.numpy(2000)
    for truth in told.truth:
        for estimate in (ours().report.estimate.mean, numpy().estimate):
            assert np.hypot(*(np.asarray(estimate)[:2] - truth[:2])) < 0.2


def test_a_movement_is_what_odometry_makes_of_it() -> None:
    for control in ScanProblem(box(), 5).controls:
        (first, way, second), sigma = movement(control)
        x, y = way * np.cos(first), way * np.sin(first)
        np.testing.assert_allclose((x, y, first + second), control, atol=1e-12)
        state = np.zeros((3, 1))
        made = works._motion().covariance(state, control)[:, :, 0]
        assert made[2, 2] == pytest.approx(sigma[0] ** 2 + sigma[2] ** 2)
