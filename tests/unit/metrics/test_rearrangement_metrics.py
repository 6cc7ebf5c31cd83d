"""The measures of PARTS on runs whose values are known by hand."""

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


def test_part_path_length():
    assert measures.normalized_part_length(PARTS, GOALS) == pytest.approx((1.4 / 1.0 + 0.48 / 0.5) / 2)


def test_a_part_that_starts_at_home_has_no_straight_way():
    parts = PARTS.copy()
    parts[:, 1] = GOALS[1]
    assert measures.normalized_part_length(parts, GOALS) == pytest.approx(1.4)
    assert measures.normalized_part_length(np.stack([GOALS, GOALS]), GOALS) == 1.0


def test_robot_path_length():
    gaps = (0.5 - 0.2) + (np.hypot(0.5, 0.5) - 0.3)
    expected = 0.7 / (gaps + np.sqrt(2.0))
    assert measures.normalized_robot_length(ROBOT, PARTS, GOALS, RADII, 0.1) == pytest.approx(expected)


def test_positional_inaccuracy_counts_in_radii():
    assert measures.positional_inaccuracy(PARTS[-1], GOALS, RADII) == pytest.approx((0.0 + 0.02 / 0.2) / 2)


def test_estimation_errors():
    assert measures.robot_position_error(ROBOT, ROBOT + SHIFT) == pytest.approx(0.05)
    assert measures.part_position_error(PARTS, PARTS + SHIFT) == pytest.approx(0.05 * np.sqrt(2.0))


def test_all_home_needs_every_part():
    assert measures.all_home(PARTS[-1], GOALS, 0.021)
    assert not measures.all_home(PARTS[-1], GOALS, 0.019)
