"""Steps down a navigation potential: each lowers it, keeps the clearances, and together they arrive."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynpf.fields.clearance import disc_clearances, wall_clearances
from dynpf.fields.descent import approach_step, carry_step
from dynpf.fields.laws import Margins, Pace
from dynpf.fields.layout import Layout
from dynpf.fields.navigation import Cost, Obstacles, carrying_potential, robot_potential
from dynpf.rng import generator
from dynpf.types import FloatArray

COST = Cost(0.06, 3.0)
PACE = Pace(longest=0.01, slow_distance=0.06, max_turn=0.04, arm=0.5, rate=0.3)
CLOSED, MARGIN = 0.002, 0.003
RADII = np.array([0.06, 0.10, 0.08, 0.11, 0.07, 0.09])


def crowded(seed: int) -> tuple[Layout, FloatArray, FloatArray]:
    """A layout of six parts with gaps of at least 4 cm, the robot between them."""
    random = generator(seed, "test", 0)
    while True:
        places = random.uniform(-0.85, 0.85, (7, 2))
        radii = np.append(RADII, 0.10)
        first, second = np.triu_indices(7, 1)
        gaps = np.hypot(*(places[first] - places[second]).T) - radii[first] - radii[second]
        if gaps.min() > 0.04:
            layout = Layout(RADII, np.zeros((6, 2)), np.ones(2), 0.10, 0.01)
            return layout, places[-1], places[:-1]


def margins(layout: Layout) -> Margins:
    return Margins(np.full(len(layout.radii), MARGIN), MARGIN)


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_descends_to_its_goal_among_parts(seed: int) -> None:
    layout, robot, parts = crowded(seed)
    obstacles = Obstacles(parts, layout.radii + CLOSED, layout.half_size - CLOSED)
    goal = next(
        place
        for place in generator(seed, "goal", 0).uniform(-0.85, 0.85, (100, 2))
        if disc_clearances(place, 0.10, parts, layout.radii).min() > 0.02
    )
    potential = robot_potential(0.10, obstacles, goal, COST)
    assert potential.reached(np.append(robot, 0.0)[None, :])[0]
    values = [potential.at(np.append(robot, 0.0)[None, :])[0]]
    for _ in range(600):
        to_go = float(np.linalg.norm(robot - goal))
        step = approach_step(potential, robot, parts, layout, margins=margins(layout), pace=PACE, to_go=to_go)
        robot = robot + step
        values.append(potential.at(np.append(robot, 0.0)[None, :])[0])
        assert disc_clearances(robot, 0.10, parts, layout.radii).min() > 0.0
        if to_go < 0.003:
            break
    assert to_go < 0.003
    assert np.all(np.diff(values) < 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_with_a_part_descends_to_its_goal_among_parts(seed: int) -> None:
    layout, robot, parts = crowded(seed)
    held, others = 0, layout.others(0)
    obstacles = Obstacles(parts[others], layout.radii[others] + CLOSED, layout.half_size - CLOSED)
    pose = np.append(robot, 0.0)
    for goal in generator(seed, "goal", 0).uniform(-0.85, 0.85, (100, 2)):
        arm = PACE.arm * layout.grip_distance(held)
        potential = carrying_potential(layout, held, obstacles, goal, COST, arm=arm, retreat=0.03)
        starts = pose + np.column_stack([np.zeros((36, 2)), 2.0 * np.pi / 36 * np.arange(36)])
        states = np.array([[*layout.held_position(start, held), start[2]] for start in starts])
        values = np.where(potential.reached(states) & (potential.at(states) < 3.0), potential.at(states), np.inf)
        free = [min(clearances(start, parts, others, layout)) > MARGIN for start in starts]
        if np.isfinite(np.where(free, values, np.inf)).any():
            pose = starts[np.argmin(np.where(free, values, np.inf))]
            break
    falls = []
    for _ in range(900):
        part = layout.held_position(pose, held)
        if np.linalg.norm(part - goal) < 0.003:
            break
        before = potential.at(np.append(part, pose[2])[None, :])[0]
        pose = pose + carry_step(potential, pose, parts, held, layout, margins=margins(layout), pace=PACE)
        falls.append(before - potential.at(np.append(layout.held_position(pose, held), pose[2])[None, :])[0])
        assert min(clearances(pose, parts, others, layout)) > 0.0
    assert np.linalg.norm(layout.held_position(pose, held) - goal) < 0.003
    assert np.mean(np.array(falls) > 0.0) == 1.0


def clearances(pose: FloatArray, parts: FloatArray, others: NDArray[np.intp], layout: Layout) -> list[float]:
    held = layout.held_position(pose, 0)
    return [
        *disc_clearances(pose[:2], 0.10, parts[others], layout.radii[others]),
        *disc_clearances(held, float(layout.radii[0]), parts[others], layout.radii[others]),
        *wall_clearances(pose[:2], 0.10, layout.half_size),
        *wall_clearances(held, float(layout.radii[0]), layout.half_size),
    ]


def test_without_a_potential_it_only_wins_back_clearance() -> None:
    """Deep in closed space, where no value is known, the step leads out of it and nowhere else."""
    layout = Layout(RADII[:1], np.zeros((1, 2)), np.ones(2), 0.10, 0.01)
    parts = np.zeros((1, 2))
    potential = robot_potential(0.10, Obstacles(parts, np.array([0.3]), np.ones(2)), np.array([0.8, 0.8]), COST)
    robot = np.array([0.0, RADII[0] + 0.10 + 0.001])
    step = approach_step(potential, robot, parts, layout, margins=margins(layout), pace=PACE, to_go=1.0)
    np.testing.assert_allclose(step, [0.0, MARGIN - 0.001], atol=1e-9)


def test_a_part_comes_to_a_goal_nearer_to_a_wall_than_a_node_of_the_grid_is() -> None:
    layout = Layout(RADII[:1], np.zeros((1, 2)), np.ones(2), 0.10, 0.01)
    goal, parts = np.array([-1.0 + RADII[0] + 0.01, 0.005]), np.zeros((1, 2))
    obstacles = Obstacles(np.zeros((0, 2)), np.zeros(0), np.ones(2) - CLOSED)
    potential = carrying_potential(layout, 0, obstacles, goal, COST, arm=0.085, retreat=0.03)
    pose = np.array([-0.4, 0.3, 2.5])
    for _ in range(200):
        pose = pose + carry_step(potential, pose, parts, 0, layout, margins=margins(layout), pace=PACE)
    np.testing.assert_allclose(layout.held_position(pose, 0), goal, atol=0.002)
