"""Trajectory errors where the answer is known, what must not be scored, and consistency."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from dynpf.metrics.trajectory import Trajectory, dead_reckoning, mean_nees_band, nees, pose_errors, score, thin
from dynpf.rng import generator

STAMPS = np.arange(0.0, 10.0, 0.1)
TRUTH = Trajectory(STAMPS, np.stack((STAMPS, 2.0 * STAMPS, np.mod(STAMPS + np.pi, 2 * np.pi) - np.pi)))


def at(stamps: np.ndarray, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Trajectory:
    return Trajectory(stamps, np.stack((stamps, 2.0 * stamps, stamps)) + np.array(offset)[:, None])


def test_the_truth_is_interpolated_also_across_the_cut_of_the_heading() -> None:
    between = np.arange(0.05, 9.8, 0.1)
    result = score(at(between), TRUTH)
    assert result.position_rmse_m == pytest.approx(0.0, abs=1e-12)
    assert result.heading_rmse_rad == pytest.approx(0.0, abs=1e-12)
    assert result.scored == between.size


def test_a_constant_offset_is_the_error_of_every_figure() -> None:
    result = score(at(STAMPS, (0.3, 0.4, 2.0 * np.pi + 0.1)), TRUTH)
    assert result.position_rmse_m == pytest.approx(0.5)
    assert result.position_median_m == pytest.approx(0.5)
    assert result.position_p95_m == pytest.approx(0.5)
    assert result.heading_rmse_rad == pytest.approx(0.1)


def test_nothing_is_scored_outside_the_truth_or_in_its_gaps() -> None:
    kept = (STAMPS < 3.0) | (STAMPS > 4.0)
    gappy = Trajectory(STAMPS[kept], TRUTH.poses[:, kept])
    stamps = np.array([-0.1, 1.0, 3.5, 5.0, 9.95])
    result = pose_errors(at(stamps), gappy)
    assert result.position_valid.tolist() == [False, True, False, True, False]
    assert pose_errors(at(stamps), gappy, max_gap=2.0).position_valid.tolist() == [False, True, True, True, False]
    nowhere = score(at(stamps[:1]), gappy)
    assert nowhere.scored == 0
    assert math.isnan(nowhere.position_rmse_m)


def test_heading_alone_is_left_out_where_the_reference_is_known_to_lie() -> None:
    lying = (STAMPS > 4.0) & (STAMPS < 6.0)
    poses = TRUTH.poses.copy()
    poses[2, lying] += 2.1
    truth = Trajectory(STAMPS, poses)
    estimate = at(np.arange(0.05, 9.8, 0.1))
    masked = score(estimate, truth, heading_valid=~lying)
    assert masked.heading_rmse_rad == pytest.approx(0.0, abs=1e-12)
    assert masked.scored == estimate.stamps.size
    assert score(estimate, truth).heading_rmse_rad > 0.5


def test_bursts_are_thinned_to_their_last() -> None:
    stamps = np.array([0.0, 0.01, 0.02, 0.15, 0.31, 0.35])
    assert thin(stamps, rate=10.0).tolist() == [2, 3, 5]
    assert thin(np.empty(0)).size == 0


def test_dead_reckoning_follows_the_arcs() -> None:
    stamps = np.array([0.0, 1.0, 3.0])
    twists = np.array([[1.0, 0.5 * np.pi, 9.9], [0.0, 0.5 * np.pi, 9.9]])
    path = dead_reckoning(stamps, twists, (1.0, 2.0, 0.0))
    assert path.poses[:, 1] == pytest.approx([2.0, 2.0, 0.0])
    assert path.poses[:2, 2] == pytest.approx([2.0, 4.0])  # half a turn of radius one
    assert abs(path.poses[2, 2]) == pytest.approx(np.pi)


def test_nees_of_an_honest_covariance_is_in_its_band_and_of_a_boastful_one_is_not() -> None:
    rng = generator(1, "test", 0)
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.05, 0.1]])
    errors = root @ rng.standard_normal((3, 400))
    covariance = np.broadcast_to(root @ root.T, (400, 3, 3))
    low, high = mean_nees_band(3, 400, 0.99)
    assert low < nees(errors, covariance).mean() < high
    assert nees(errors, covariance / 2.0).mean() > high
    assert nees(errors, covariance * 2.0).mean() < low


def test_nees_of_a_singular_covariance_is_not_a_number() -> None:
    covariances = np.stack((np.eye(3), np.zeros((3, 3))))
    values = nees(np.ones((3, 2)), covariances)
    assert values[0] == pytest.approx(3.0)
    assert math.isnan(values[1])


@pytest.mark.parametrize(("dimension", "count"), [(3, 10), (2, 50), (3, 5000)])
@pytest.mark.parametrize("probability", [0.9, 0.95, 0.99])
def test_the_band_is_that_of_chi_square(dimension: int, count: int, probability: float) -> None:
    tail = 0.5 * (1.0 - probability)
    exact = chi2.ppf([tail, 1.0 - tail], dimension * count) / count
    assert mean_nees_band(dimension, count, probability) == pytest.approx(exact, rel=1e-2)


def test_a_truth_of_one_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="at least two"):
        score(at(STAMPS), Trajectory(STAMPS[:1], TRUTH.poses[:, :1]))
