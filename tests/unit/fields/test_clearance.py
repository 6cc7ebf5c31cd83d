"""The clearance filter: clearances stay above their margins, and the step is the nearest that does it."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from dynpf.fields.clearance import carrying_bounds, disc_clearances, project_step, robot_bounds, wall_clearances
from dynpf.fields.layout import Layout
from dynpf.rng import generator
from dynpf.types import FloatArray

LAYOUT = Layout(
    radii=np.array([0.06, 0.08, 0.11]),
    goals=np.zeros((3, 2)),
    half_size=np.array([1.0, 0.8]),
    robot_radius=0.10,
    reach=0.01,
)
MARGIN, RATE, LONGEST, MAX_TURN = 0.012, 0.3, 0.01, 0.04
HELD = 2
COORDINATE = st.floats(-0.9, 0.9)
POINT = st.tuples(COORDINATE, COORDINATE)
Point = tuple[float, float]


def robot_clearances(robot: FloatArray, parts: FloatArray) -> FloatArray:
    discs = disc_clearances(robot, LAYOUT.robot_radius, parts, LAYOUT.radii)
    return np.concatenate([discs, wall_clearances(robot, LAYOUT.robot_radius, LAYOUT.half_size)])


def carrying_clearances(pose: FloatArray, parts: FloatArray) -> FloatArray:
    """Clearances of robot and held part from everything else, written out without the bounds' own code."""
    held = LAYOUT.held_position(pose, HELD)
    found = []
    for centre, radius in ((pose[:2], LAYOUT.robot_radius), (held, LAYOUT.radii[HELD])):
        found += [np.linalg.norm(centre - parts[i]) - radius - LAYOUT.radii[i] for i in (0, 1)]
        found += [LAYOUT.half_size[axis] - side * centre[axis] - radius for side in (1, -1) for axis in (0, 1)]
    return np.array(found)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(at=POINT, parts_at=st.tuples(POINT, POINT, POINT), direction=st.floats(-3.2, 3.2))
def test_the_robot_never_uses_up_a_margin(at: Point, parts_at: tuple[Point, ...], direction: float) -> None:
    robot, parts = np.array(at), np.array(parts_at)
    before = robot_clearances(robot, parts)
    assume(before.min() > MARGIN)
    wanted = LONGEST * np.array([np.cos(direction), np.sin(direction)])
    rows, clearances = robot_bounds(robot, parts, LAYOUT)
    np.testing.assert_allclose(clearances, before)
    step = project_step(wanted, rows, clearances, np.full(7, MARGIN), RATE)
    after = robot_clearances(robot + step, parts)
    assert np.all(after >= before - RATE * (before - MARGIN) - 1e-9)
    assert np.linalg.norm(step) <= LONGEST + 1e-9


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    at=POINT, theta=st.floats(-3.1, 3.1), others_at=st.tuples(POINT, POINT), wanted=st.tuples(*[st.floats(-1, 1)] * 3)
)
def test_robot_and_held_part_never_use_up_a_margin(
    at: Point, theta: float, others_at: tuple[Point, ...], wanted: tuple[float, ...]
) -> None:
    pose = np.array([*at, theta])
    parts = np.array([*others_at, LAYOUT.held_position(pose, HELD)])
    rows, clearances = carrying_bounds(pose, parts, HELD, LAYOUT, MAX_TURN)
    assume(clearances.min() > MARGIN)
    step = project_step(LONGEST * np.array(wanted), rows, clearances, np.full(len(rows), MARGIN), RATE)
    assume(abs(step[2]) <= MAX_TURN)
    assert carrying_clearances(pose + step, parts).min() >= MARGIN - 1e-9


def test_without_the_filter_the_margin_is_used_up() -> None:
    """Control for the two invariants above: the same steps unfiltered break it."""
    parts = np.array([[0.5, 0.5], [-0.5, 0.5], [0.0, -0.5]])
    robot = parts[0] - [LAYOUT.robot_radius + 0.06 + MARGIN + 0.001, 0.0]
    assert robot_clearances(robot + np.array([LONGEST, 0.0]), parts).min() < MARGIN


def test_is_the_nearest_step_that_meets_the_bounds() -> None:
    """Against least-distance programming by non-negative least squares (Lawson and Hanson 1974, chapter 23)."""
    random = generator(4, "test", 0)
    bound = 0
    for _ in range(60):
        rows = random.standard_normal((5, 3))
        rows /= np.linalg.norm(rows, axis=1)[:, None]
        clearances, wanted = random.uniform(0.0, 0.05, 5), random.uniform(-0.1, 0.1, 3)
        step = project_step(wanted, rows, clearances, np.zeros(5), 0.5)
        system = np.vstack([rows.T, -0.5 * clearances - rows @ wanted])
        multipliers, _ = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
        residual = system @ multipliers - [0.0, 0.0, 0.0, 1.0]
        np.testing.assert_allclose(step, wanted - residual[:3] / residual[3], atol=1e-8)
        bound += not np.allclose(step, wanted)
    assert bound > 20


def test_below_the_margin_the_step_wins_it_back() -> None:
    rows, clearances = np.array([[1.0, 0.0]]), np.array([0.004])
    step = project_step(np.array([-0.01, 0.003]), rows, clearances, np.array([0.01]), RATE)
    np.testing.assert_allclose(step, [0.006, 0.003])


def test_between_two_walls_too_close_it_stands_rather_than_chooses() -> None:
    rows, clearances = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([0.004, 0.004])
    step = project_step(np.array([0.01, 0.002]), rows, clearances, np.full(2, 0.01), RATE)
    np.testing.assert_allclose(step, [0.0, 0.002], atol=1e-9)


def test_concentric_discs_have_a_way_out() -> None:
    parts = np.array([[0.2, 0.2], [-0.5, 0.5], [0.0, -0.5]])
    rows, clearances = robot_bounds(parts[0], parts, LAYOUT)
    assert np.isfinite(rows).all()
    assert clearances[0] == pytest.approx(-0.16)
