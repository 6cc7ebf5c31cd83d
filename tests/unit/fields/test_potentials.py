"""The potentials of PARTS: gradients against finite differences, descent, and next-part's choice."""

from collections.abc import Callable

import numpy as np
import pytest

from dynpf.fields import potentials
from dynpf.fields.layout import Layout
from dynpf.fields.speed import descent_step, swing_basis
from dynpf.rng import generator
from dynpf.types import FloatArray

LAYOUT = Layout(
    radii=np.array([0.06, 0.08, 0.11]),
    goals=np.array([[0.0, 0.55], [-0.476, -0.275], [0.476, -0.275]]),
    half_size=np.array([1.0, 1.0]),
    robot_radius=0.10,
    reach=0.01,
)
PARTS = np.array([[0.5, 0.4], [-0.3, 0.6], [0.1, -0.5]])


def finite_difference(function: Callable[[FloatArray], float], point: FloatArray, step: float = 1e-6) -> FloatArray:
    """Central differences, an oracle that shares nothing with the analytic gradient."""
    gradient = np.empty(point.shape)
    for index in np.ndindex(point.shape):
        shift = np.zeros(point.shape)
        shift[index] = step
        gradient[index] = (function(point + shift) - function(point - shift)) / (2 * step)
    return gradient


def log_next_part(parts: FloatArray, exponent: float) -> float:
    """PARTS eq. 2.1: k log ||b - g||^2 less log beta over pairs."""
    first, second = np.triu_indices(len(parts), 1)
    apart = np.sum((parts[first] - parts[second]) ** 2, axis=1) - (LAYOUT.radii[first] + LAYOUT.radii[second]) ** 2
    return float(exponent * np.log(np.sum((parts - LAYOUT.goals) ** 2)) - np.sum(np.log(apart)))


@pytest.mark.parametrize("exponent", [2.0, 8.0])
def test_next_part_gradient(exponent: float) -> None:
    expected = finite_difference(lambda parts: log_next_part(parts, exponent), PARTS)
    np.testing.assert_allclose(potentials.next_part_gradient(PARTS, LAYOUT, exponent), expected, rtol=1e-6)


@pytest.mark.parametrize("target", [0, 1, 2])
def test_mate_part_gradient(target: int) -> None:
    robot = np.array([-0.2, -0.1])
    expected = finite_difference(lambda r: potentials.log_mate_part(r, PARTS, target, LAYOUT, 8.0), robot)
    np.testing.assert_allclose(potentials.mate_part_gradient(robot, PARTS, target, LAYOUT, 8.0), expected, rtol=1e-6)


@pytest.mark.parametrize("held", [0, 1, 2])
def test_move_part_gradient(held: int) -> None:
    pose = np.array([-0.2, -0.1, 0.7])
    expected = finite_difference(lambda q: potentials.log_move_part(q, PARTS, held, LAYOUT, 8.0), pose)
    np.testing.assert_allclose(potentials.move_part_gradient(pose, PARTS, held, LAYOUT, 8.0), expected, rtol=1e-6)


def test_contact_is_where_the_discs_touch() -> None:
    """With (rho_i + rho_j)^2 the potential rises without bound towards contact; with the printed sign it would not."""
    contact = LAYOUT.robot_radius + LAYOUT.radii[1]
    away = np.array([1.0, 0.0])
    near, far = (
        potentials.log_mate_part(PARTS[1] + away * (contact + gap), PARTS, 0, LAYOUT, 8.0) for gap in (2e-3, 2e-2)
    )
    assert near > far + 2.0


def test_an_overlap_still_leads_away() -> None:
    robot = PARTS[1] + np.array([0.05, 0.0])
    step = descent_step(potentials.mate_part_gradient(robot, PARTS, 0, LAYOUT, 8.0), 1.0)
    assert step[0] > 0.99


def test_next_part_is_the_steepest_candidate() -> None:
    steepness = np.linalg.norm(potentials.next_part_gradient(PARTS, LAYOUT, 8.0), axis=1)
    order = np.argsort(-steepness).tolist()
    assert potentials.steepest_part(PARTS, [0, 1, 2], LAYOUT, 8.0) == order[0]
    assert potentials.steepest_part(PARTS, order[1:], LAYOUT, 8.0) == order[1]
    with pytest.raises(ValueError, match="no candidates"):
        potentials.steepest_part(PARTS, [], LAYOUT, 8.0)


def test_of_equally_steep_parts_the_first_is_next() -> None:
    goals = np.array([[0.5, 0.0], [-0.5, 0.0]])
    layout = LAYOUT._replace(goals=goals, radii=np.array([0.1, 0.1]))
    assert potentials.steepest_part(0.6 * goals, [1, 0], layout, 8.0) == 0


def test_swing_coordinates_move_the_part_alone_or_turn_the_robot_about_it() -> None:
    pose, distance, arm = np.array([0.1, -0.2, 0.8]), LAYOUT.grip_distance(1), 0.1
    basis = swing_basis(0.8, distance, arm)
    part = LAYOUT.held_position(pose, 1)
    moved = LAYOUT.held_position(pose + basis @ np.array([1e-4, 2e-4, 0.0]), 1)
    np.testing.assert_allclose(moved - part, [1e-4, 2e-4], atol=1e-12)
    turned = pose + basis @ np.array([0.0, 0.0, 1e-6])
    assert turned[2] - pose[2] == pytest.approx(1e-6 / arm)
    np.testing.assert_allclose(LAYOUT.held_position(turned, 1), part, atol=1e-10)


def test_far_from_obstacles_descent_points_at_the_goal() -> None:
    far_parts = np.array([[0.9, 0.9], [-0.9, 0.9], [0.9, -0.9]])
    random = generator(3, "test", 0)
    for _ in range(20):
        robot = random.uniform(-0.3, 0.3, 2)
        step = descent_step(potentials.mate_part_gradient(robot, far_parts, 0, LAYOUT, 8.0), 1.0)
        towards = (far_parts[0] - robot) / np.linalg.norm(far_parts[0] - robot)
        assert step @ towards > 0.9
