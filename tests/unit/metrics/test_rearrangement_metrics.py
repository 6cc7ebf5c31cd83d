"""The measures of PARTS on runs whose values are known by hand."""

import math

import numpy as np
import pytest

from dynpf.metrics import rearrangement as measures

GOALS = np.array([[1.0, 0.0], [0.0, 1.0]])
RADII = np.array([0.1, 0.2])
# Part 0 goes 0.6 + 0.8 for a straight way of 1; part 1 goes straight.
PARTS = np.array(
    [
        [[0.0, 0.0], [0.0, 0.5]],
        [[0.36, 0.48], [0.0, 0.75]],
        [[1.0, 0.0], [0.0, 0.98]],
    ]
)
SHIFT = np.array([0.03, 0.04])
ROBOT = np.array([[-0.5, 0.0], [-0.5, 0.3], [-0.1, 0.3]])


def test_part_path_length() -> None:
    assert measures.normalized_part_length(PARTS, GOALS) == pytest.approx((1.4 / 1.0 + 0.48 / 0.5) / 2)


def test_a_part_that_starts_at_home_has_no_straight_way() -> None:
    parts = PARTS.copy()
    parts[:, 1] = GOALS[1]
    assert measures.normalized_part_length(parts, GOALS) == pytest.approx(1.4)
    assert measures.normalized_part_length(np.stack([GOALS, GOALS]), GOALS) == 1.0


def test_robot_path_length() -> None:
    gaps = (0.5 - 0.2) + (np.hypot(0.5, 0.5) - 0.3)
    expected = 0.7 / (gaps + np.sqrt(2.0))
    assert measures.normalized_robot_length(ROBOT, PARTS, GOALS, RADII, 0.1) == pytest.approx(expected)


def test_positional_inaccuracy_counts_in_radii() -> None:
    assert measures.positional_inaccuracy(PARTS[-1], GOALS, RADII) == pytest.approx((0.0 + 0.02 / 0.2) / 2)


def test_estimation_errors() -> None:
    assert measures.robot_position_error(ROBOT, ROBOT + SHIFT) == pytest.approx(0.05)
    assert measures.part_position_error(PARTS, PARTS + SHIFT) == pytest.approx(0.05 * np.sqrt(2.0))


def test_all_home_needs_every_part() -> None:
    assert measures.all_home(PARTS[-1], GOALS, 0.021)
    assert not measures.all_home(PARTS[-1], GOALS, 0.019)


def test_packing_density_by_hand() -> None:
    """Two unit discs, centres 3 m apart: ln(1e4 (9 - 4))."""
    goals = np.array([[0.0, 0.0], [3.0, 0.0]])
    assert measures.packing_density(goals, np.ones(2)) == pytest.approx(100.0 / math.log(5e4))
    assert measures.packing_density(goals[:1], np.ones(1)) == 0.0
    closer = measures.packing_density(goals * 0.7, np.ones(2))
    assert closer > measures.packing_density(goals, np.ones(2))
    with pytest.raises(ValueError, match="overlap"):
        measures.packing_density(goals * 0.5, np.ones(2))


def test_signal_to_noise_in_decibels() -> None:
    assert measures.signal_to_noise_db(np.array([0.1, 0.1]), 1e-4) == pytest.approx(20.0)
    assert measures.signal_to_noise_db(np.array([0.1]), 0.0) == math.inf
    assert measures.signal_to_noise_db(np.zeros(3), 1.0) == -math.inf


def test_kurtosis_of_a_gaussian_and_of_a_uniform_density() -> None:
    random = np.random.default_rng(1)
    assert measures.kurtosis(random.standard_normal((2, 100_000))) == pytest.approx(3.0, abs=0.05)
    assert measures.kurtosis(random.uniform(size=(2, 100_000))) == pytest.approx(1.8, abs=0.02)
    small = np.mean([measures.kurtosis(random.standard_normal((2, 20))) for _ in range(4000)])
    assert small == pytest.approx(3.0 * 19.0 / 21.0, abs=0.02)


def test_the_bound_settles_where_riccati_says() -> None:
    process, measured = 0.06e-4, 1e-4
    bound = measures.robot_bound(np.full(200, 1.0 / measured), process)
    # P = (P + Q) R / (P + Q + R) for a coordinate.
    settled = 0.5 * (math.sqrt(process**2 + 4.0 * process * measured) - process)
    assert bound.noisy[0] == pytest.approx(math.sqrt(2.0 * measured))
    assert bound.noisy[-1] == pytest.approx(math.sqrt(2.0 * settled))
    np.testing.assert_allclose(bound.noiseless, np.sqrt(2.0 * measured / np.arange(1, 201)))


def test_two_sights_halve_the_variance_of_a_motion_without_noise() -> None:
    information = np.array([1.0, 2.0, 2.0])
    np.testing.assert_allclose(measures.robot_bound(information, 0.0).noisy, np.sqrt(2.0 / np.array([1.0, 3.0, 5.0])))


def test_the_ratio_to_a_bound_of_nothing_is_not_a_number() -> None:
    assert measures.bound_ratio(np.array([3.0, 4.0]), np.array([2.5, 2.5])) == pytest.approx(math.sqrt(2.0))
    assert math.isnan(measures.bound_ratio(np.ones(2), np.zeros(2)))
