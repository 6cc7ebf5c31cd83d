"""Parts that look alike: the layouts, the test of solvability, and runs that are right or say that they are not."""

import math

import msgspec
import numpy as np
import pytest
from dynpf_experiments.drive import drive
from dynpf_systems.parts.config import Hiding, Intervention
from dynpf_systems.parts.measures import TOPICS, course_of, rearrangement
from dynpf_systems.parts.studies.alike import COUNTS, alike_scenario, alike_task, crowd_task, solvable_seeds
from dynpf_systems.parts.studies.solvable import order_of
from dynpf_systems.parts.task import PartSpec, RearrangementTask, layout_of

PAIR = RearrangementTask(
    parts=tuple(PartSpec(radius=r, goal=g) for r, g in zip((0.05, 0.05), ((0.4, 0.3), (-0.4, 0.3)), strict=True)),
    robot_radius=0.05,
)


def outcome(scenario, ticks):
    """Return the measures of a run, and its last identities."""
    course = course_of(drive(scenario.changed(max_ticks=ticks), TOPICS))
    assert course is not None
    return rearrangement(course), course.identities[-1]


@pytest.mark.parametrize("number", range(len(COUNTS)))
def test_layouts_have_equal_parts_and_every_second_a_robot_of_their_size(number):
    task = alike_task(number)
    radii = {part.radius for part in task.parts}
    assert len(task.parts) == COUNTS[number]
    assert len(radii) == 1
    assert (task.robot_radius in radii) == (number % 2 == 1)
    assert len(crowd_task(number).parts) == 20


def test_a_ring_that_the_robot_cannot_enter_is_not_solvable_without_putting_a_part_aside():
    """Eight parts at home around the one that shall come out; with one of them gone there is a way."""
    angles = np.arange(8) * math.tau / 8
    ring = [(0.22 * math.cos(angle), 0.22 * math.sin(angle)) for angle in angles.tolist()]
    centre, out, robot = (0.0, 0.0), (0.7, 0.7), np.array([-0.7, -0.7])

    def order(around):
        specs = tuple(PartSpec(radius=0.06, goal=goal) for goal in (out, *around))
        layout = layout_of(RearrangementTask(parts=specs, robot_radius=0.06))
        return order_of(layout, robot, np.array([centre, *around]))

    assert order(ring) is None
    assert order(ring[:5]) is not None


def test_runs_of_a_layout_begin_where_it_can_be_solved():
    task = alike_task(0)
    first = next(solvable_seeds(task, 1))
    assert first == next(solvable_seeds(task, 1))
    assert list(solvable_seeds(task, 1, 0)) == []


@pytest.mark.parametrize(("known", "finished"), [("interchangeable", True), ("starts", True), ("nothing", False)])
def test_equal_discs_come_home_where_something_tells_who_is_who_and_else_the_run_says_so(known, finished):
    found, identities = outcome(alike_scenario(PAIR, 3, "low", known, camera=False), 1500)
    assert found["finished"] == found["completed"] == finished
    assert found["swaps_unnoticed"] == found["collisions"] == 0
    assert identities[0] > 0.999
    if finished:
        assert identities.min() > 0.999  # both are in view
    else:
        np.testing.assert_allclose(identities[1:], 0.5, atol=1e-3)


@pytest.mark.parametrize("moved", [1, 2])
def test_two_that_were_hidden_and_moved_meanwhile_are_told_where_one_is_not_confused(moved):
    """One that was moved is known, as the other is where it was; of two nobody knows which is which."""
    scenario = alike_scenario(PAIR, 3, "low", "starts", camera=False)
    hidings = tuple(Hiding(tick=10, ticks=40, part=part) for part in range(2))
    away = ((0.0, 0.75), (0.0, -0.75))
    interventions = tuple(Intervention(tick=20, part=part, to=away[part]) for part in range(moved))
    disturbed = msgspec.structs.replace(scenario.simulator, hidings=hidings, interventions=interventions)
    found, identities = outcome(scenario.changed(simulator=disturbed), 1500)
    assert found["swaps_unnoticed"] == 0
    assert found["finished"] == found["completed"] == (moved == 1)
    assert (identities[1:].max() > 0.999) == (moved == 1)


def test_colours_tell_two_equal_parts_apart_in_the_cameras_frames():
    """Robot and parts are as large as each other; the control has them in one colour."""
    colours = ((20, 20, 200), (200, 40, 20))

    def certain(given):
        painted = zip(PAIR.parts, given, strict=True)
        parts = tuple(msgspec.structs.replace(part, colour=colour) for part, colour in painted)
        task = msgspec.structs.replace(PAIR, parts=parts)
        found, identities = outcome(alike_scenario(task, 3, "low", "nothing", camera=True), 12)
        assert found["swaps_unnoticed"] == 0
        return identities[1:]

    assert certain(colours).min() > 0.999
    np.testing.assert_allclose(certain(colours[:1] * 2), 0.5, atol=1e-3)
