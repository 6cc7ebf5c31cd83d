"""Angles, composition and arcs, against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.se2 import arc_displacement, circular_mean, compose, relative, wrap_angle

ANGLES = st.floats(-1e3, 1e3)


@settings(derandomize=True, deadline=None)
@given(ANGLES)
def test_a_wrapped_angle_is_in_range_and_points_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert abs(wrapped) <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-12)
    assert wrap_angle(wrapped) == wrapped


@settings(derandomize=True, deadline=None)
@given(ANGLES, st.floats(-10, 10), st.floats(-7, 7))
def test_composition_moves_by_the_rotated_displacement(heading: float, x: float, theta: float) -> None:
    pose = compose(np.array([1.0, 2.0, heading]), np.array([x, -0.5, theta]))
    moved = complex(1.0, 2.0) + complex(x, -0.5) * np.exp(1j * heading)
    assert complex(pose[0], pose[1]) == pytest.approx(moved, abs=1e-9)
    assert np.exp(1j * pose[2]) == pytest.approx(np.exp(1j * (heading + theta)), abs=1e-9)


def test_the_circular_mean_goes_the_short_way_round() -> None:
    across_the_cut = np.array([np.pi - 0.1, -np.pi + 0.3])
    assert circular_mean(across_the_cut, np.array([0.5, 0.5])) == pytest.approx(-np.pi + 0.1)
    assert circular_mean(np.array([0.2, 1.0]), np.array([1.0, 0.0])) == pytest.approx(0.2)


def test_a_quarter_circle_ends_at_its_corner() -> None:
    assert arc_displacement(0.5 * np.pi * 2.0, 0.5 * np.pi) == pytest.approx([2.0, 2.0, 0.5 * np.pi])


def test_the_arc_has_the_straight_line_as_its_limit() -> None:
    assert arc_displacement(3.0, 0.0).tolist() == [3.0, 0.0, 0.0]
    nearly = arc_displacement(3.0, np.array([1e-300, 1e-9, -1e-9]))
    assert nearly[0] == pytest.approx(3.0, rel=1e-15)
    assert nearly[1] == pytest.approx([0.0, 1.5e-9, -1.5e-9], rel=1e-9)


@settings(derandomize=True, deadline=None)
@given(ANGLES, st.floats(-10, 10), st.floats(-7, 7))
def test_a_relative_pose_undoes_composition(heading: float, x: float, theta: float) -> None:
    pose, step = np.array([1.0, 2.0, heading]), np.array([x, -0.5, theta])
    found = relative(pose, compose(pose, step))
    assert found[:2] == pytest.approx(step[:2], abs=1e-9)
    assert np.exp(1j * found[2]) == pytest.approx(np.exp(1j * theta), abs=1e-9)
