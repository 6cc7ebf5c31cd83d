"""Blocked goals and places to put a part that stands in the way."""

import numpy as np

from dynpf.fields.clearance import disc_clearances, wall_clearances
from dynpf.fields.layout import Layout
from dynpf.fields.placing import blocked_goals, free_place

LAYOUT = Layout(
    radii=np.array([0.06, 0.08, 0.11]),
    goals=np.array([[0.0, 0.55], [-0.476, -0.275], [0.476, -0.275]]),
    half_size=np.array([1.0, 1.0]),
    robot_radius=0.10,
    reach=0.01,
)


def test_a_part_at_its_own_goal_blocks_nobody() -> None:
    blocked, blocking = blocked_goals(LAYOUT.goals, LAYOUT, 0.005)
    assert not blocked.any()
    assert not blocking.any()


def test_a_swap_blocks_both() -> None:
    parts = LAYOUT.goals[[1, 0, 2]]
    blocked, blocking = blocked_goals(parts, LAYOUT, 0.005)
    assert blocked.tolist() == [True, True, False]
    assert blocking.tolist() == [True, True, False]


def test_a_free_place_is_near_and_clear_of_parts_goals_and_walls() -> None:
    parts = LAYOUT.goals[[1, 0, 2]]
    place = free_place(parts, 0, LAYOUT, 0.2)
    assert place is not None
    for centres, radii in ((parts[1:], LAYOUT.radii[1:]), (LAYOUT.goals, LAYOUT.radii)):
        assert disc_clearances(place, 0.06, centres, radii).min() >= 0.2
    assert wall_clearances(place, 0.06, LAYOUT.half_size).min() >= 0.2 - 1e-12
    assert np.linalg.norm(place - parts[0]) < 0.45


def test_a_full_workspace_has_no_free_place() -> None:
    assert free_place(LAYOUT.goals, 0, LAYOUT, 0.9) is None
    assert free_place(LAYOUT.goals, 0, LAYOUT._replace(half_size=np.array([0.5, 0.5])), 0.5) is None
