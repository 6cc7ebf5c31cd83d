"""Trajectory errors where the answer is known, and what must not be scored."""

import math

import numpy as np
import pytest

from dynpf.metrics.trajectory import Trajectory, dead_reckoning, pose_errors, score, thin

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


def test_a_truth_of_one_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="at least two"):
        score(at(STAMPS), Trajectory(STAMPS[:1], TRUTH.poses[:, :1]))
