"""Navigation potentials: kernels as their twins, ways as long as they are, no local minima, who is in the way."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.fields.layout import Layout
from dynpf.fields.navigation import (
    Cost,
    Obstacles,
    carrying_potential,
    crossed_parts,
    robot_potential,
    spare,
)
from dynpf.reference import fields as reference
from dynpf.rng import generator

LAYOUT = Layout(
    radii=np.array([0.06, 0.08, 0.11]),
    goals=np.zeros((3, 2)),
    half_size=np.array([1.0, 0.8]),
    robot_radius=0.10,
    reach=0.01,
)
OPEN = Obstacles(np.zeros((0, 2)), np.zeros(0), LAYOUT.half_size)
FLAT = Cost(0.06, 0.0)
# A wall of four discs across the workspace that leaves no gap for a robot.
X = np.array([-0.75, -0.25, 0.25, 0.75])
BARRIER = Obstacles(np.column_stack([X, np.zeros(4)]), np.full(4, 0.16), LAYOUT.half_size)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6), shape=st.sampled_from([(9, 7, 1), (6, 5, 4), (4, 4, 7)]))
def test_marches_as_its_twin(seed: int, shape: tuple[int, int, int]) -> None:
    """Float32 rounds each of a few dozen additions on the way by half a unit in the last place of at most 8."""
    random = generator(seed, "test", 0)
    slowness = random.uniform(1.0, 4.0, shape).astype(np.float32)
    slowness[random.random(shape) < 0.3] = np.inf
    values = np.full(shape, np.inf, dtype=np.float32)
    slowness[2, 3, 0], values[2, 3, 0] = 1.0, 0.1
    spacing = np.array([0.1, 0.1, 0.07], dtype=np.float32)
    expected, layers = reference.march(values.astype(float), slowness.astype(float), spacing.astype(float), 2, 5.0)
    depths = kernels.fields.march(values, slowness, spacing, 2, 5.0)
    np.testing.assert_array_equal(depths, layers)
    np.testing.assert_allclose(values, expected, rtol=0.0, atol=2e-5)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_interpolates_and_measures_clearances_as_the_twins(seed: int) -> None:
    random = generator(seed, "test", 0)
    potential = carrying_potential(
        LAYOUT._replace(half_size=np.array([0.4, 0.3])),
        0,
        OPEN._replace(half_size=np.array([0.4, 0.3])),
        random.uniform(-0.1, 0.1, 2),
        Cost(0.06, 3.0),
        arm=0.1,
        retreat=0.03,
    )
    states = random.uniform([-0.45, -0.35, -7.0], [0.45, 0.35, 7.0], (50, 3))
    x, y = (potential.lower[axis] + potential.spacing * np.arange(potential.values.shape[axis]) for axis in (0, 1))
    distance = np.sqrt((x[:, None] - potential.goal[0]) ** 2 + (y - potential.goal[1]) ** 2 + 1e-4)
    turns = potential.values.shape[2] / (2.0 * np.pi)
    frame = np.array([*potential.lower, 1.0 / potential.spacing, turns, *potential.goal, 0.01])
    expected = reference.interpolate(potential.values / distance[:, :, None], frame, states)
    # A state that float32 takes to the other side of a node is interpolated from there: the values agree.
    np.testing.assert_allclose(potential.at(states), expected, rtol=2e-4, atol=1e-5)
    points = random.uniform(-1.0, 1.0, (50, 2))
    found = spare(points, 0.1, BARRIER)
    np.testing.assert_allclose(
        found, reference.spare_clearances(points, 0.1, BARRIER.centres, BARRIER.kept, BARRIER.half_size), atol=1e-6
    )


def test_in_the_open_it_is_the_distance() -> None:
    """First-order upwind differences overestimate a distance on the diagonal most: by about h log(r / h) / 2."""
    goal = np.array([0.2, -0.1])
    states = np.column_stack([generator(1, "test", 0).uniform(-0.65, 0.65, (200, 2)), np.zeros(200)])
    distance = np.hypot(*(states[:, :2] - goal).T)
    error = robot_potential(0.1, OPEN, goal, FLAT).at(states) - np.hypot(distance, 0.01)
    assert error.min() > -1e-3
    assert error.max() < 0.03


def test_the_way_around_an_obstacle_is_its_tangents_and_arc() -> None:
    """Too long by up to 5 %: first-order differences, and a circle made of squares."""
    disc = Obstacles(np.zeros((1, 2)), np.array([0.2]), LAYOUT.half_size)
    radius, far = 0.3, 0.6  # of robot and obstacle together
    potential = robot_potential(0.1, disc, np.array([-far, 0.0]), FLAT)
    angle = np.pi - 2.0 * np.arccos(radius / far)
    around = 2.0 * np.sqrt(far**2 - radius**2) + radius * angle
    assert potential.at(np.array([[far, 0.0, 0.0]]))[0] == pytest.approx(around * 1.025, rel=0.025)


def test_there_is_no_way_through_a_barrier_and_there_is_one_around() -> None:
    goal = np.array([0.0, 0.5])
    beyond = np.array([[0.0, -0.5, 0.0], [0.3, 0.4, 0.0]])
    assert robot_potential(0.1, BARRIER, goal, FLAT).reached(beyond).tolist() == [False, True]
    gap = BARRIER._replace(centres=BARRIER.centres[:3], kept=BARRIER.kept[:3])
    assert robot_potential(0.1, gap, goal, FLAT).reached(beyond).tolist() == [True, True]


def test_from_within_a_margin_the_gradient_leads_out_of_it() -> None:
    potential = robot_potential(0.1, BARRIER, np.array([0.0, 0.5]), FLAT)
    state = np.array([0.25, 0.24, 0.0])
    assert spare(state[None, :2], 0.1, BARRIER)[0] < 0.0
    assert potential.reached(state[None, :])[0]
    assert potential.gradient(state, 1.0)[1] < 0.0


def test_no_state_with_a_way_is_a_local_minimum() -> None:
    """Every node that the front reached, but those it started from, has a neighbour nearer to the goal."""
    obstacles = Obstacles(np.array([[0.0, 0.1], [0.35, -0.2]]), np.array([0.09, 0.12]), LAYOUT.half_size)
    potential = carrying_potential(LAYOUT, 0, obstacles, np.array([0.5, 0.3]), Cost(0.06, 3.0), arm=0.085, retreat=0.03)
    values = np.where(potential.depths == 0, potential.values, np.inf)
    padded = np.pad(values, ((1, 1), (1, 1), (0, 0)), constant_values=np.inf)
    lowest = np.min(
        [
            padded[:-2, 1:-1],
            padded[2:, 1:-1],
            padded[1:-1, :-2],
            padded[1:-1, 2:],
            np.roll(values, 1, axis=2),
            np.roll(values, -1, axis=2),
        ],
        axis=0,
    )
    x = potential.lower[0] + potential.spacing * np.arange(values.shape[0])
    y = potential.lower[1] + potential.spacing * np.arange(values.shape[1])
    away = np.hypot(x[:, None] - 0.5, y - 0.3) > 0.07
    minimal = (lowest >= values) & np.isfinite(values) & away[:, :, None]
    assert not minimal.any()
    assert np.isfinite(values).sum() > 50_000


def test_a_carried_part_ends_only_where_the_robot_fits_and_can_leave() -> None:
    """The goal lies by the wall at +x: a robot with its gripper away from the wall would stand in it."""
    goal = np.array([0.92, 0.0])
    potential = carrying_potential(LAYOUT, 0, OPEN, goal, FLAT, arm=0.085, retreat=0.03)
    inward, outward = potential.at(np.array([[*goal, np.pi], [*goal, 0.0]]))
    assert outward < 0.02
    assert not inward < 0.1


def test_who_stands_in_the_way_is_whom_the_way_crosses() -> None:
    layout = LAYOUT._replace(radii=np.array([*[0.16] * 4, 0.06]), goals=np.zeros((5, 2)))
    crossed = partial(crossed_parts, layout, 4, obstacles=BARRIER, indices=np.arange(4), cost=Cost(0.06, 3.0), arm=0.1)
    part = np.array([0.25, -0.4])
    across = crossed(np.array([[0.25, 0.4], part]), goal=np.array([0.25, -0.6]))
    assert set(across) <= {1, 2, 3}
    assert across
    beside = np.array([[-0.2, -0.4], part])
    assert crossed(beside, goal=np.array([0.25, -0.55])) == []
    assert crossed(beside, goal=X[2] * np.array([1.0, 0.0]) - [0.0, 0.05]) == [2]
