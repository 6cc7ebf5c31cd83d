"""Who is who among discs that look alike: closed forms of the belief, and what tells the discs apart."""

import math

import numpy as np
import pytest
from dynpf_systems.parts.config import RearrangementConfig
from dynpf_systems.parts.identities import Look, WhoIsWho, alike, hypotheses
from dynpf_systems.parts.task import Noise, PartSpec, RearrangementTask

NOISE = Noise(0.06e-4, 0.2e-4)
PLACES = np.array([(0.0, 0.0), (0.5, 0.0), (-0.5, 0.3)])
STILL = np.zeros(2)
NONE = ((math.nan,) * 3,) * 3
RED, BLUE = (20, 20, 200), (200, 40, 20)


def task(radii=(0.08, 0.08), robot_radius=0.08, starts=(None, None), colours=(None, None), **more):
    given = zip(radii, starts, colours, strict=True)
    parts = tuple(PartSpec(radius=radius, goal=(0.0, 0.0), start=at, colour=paint) for radius, at, paint in given)
    return RearrangementTask(parts=parts, robot_radius=robot_radius, **more)


def belief(given, **config):
    return WhoIsWho(given, RearrangementConfig(**config), NOISE)


def see(who, centres=PLACES, *, radii=(0.08, 0.08, 0.08), colours=NONE, missing=(), lost=(), shift=STILL):
    """Show the discs of all tracks but the ``missing``; the ``lost`` have been missing for long."""
    seen, gone = (~np.isin(np.arange(3), which) for which in (missing, lost))
    who.update(
        Look(seen, np.array(centres), np.array(radii), np.array(colours)), ~gone & ~seen, -1, shift, NOISE.process
    )


def test_two_names_have_the_odds_of_the_two_hypotheses():
    evidence = np.array([[1.0, 0.3], [-0.5, 0.2]])
    odds = math.exp((1.0 + 0.2) - (0.3 - 0.5))
    likely = odds / (1.0 + odds)
    np.testing.assert_allclose(hypotheses(evidence), [[likely, 1 - likely], [1 - likely, likely]])


def test_without_evidence_each_of_n_is_as_likely():
    np.testing.assert_allclose(hypotheses(np.zeros((5, 5))), np.full((5, 5), 0.2))


def test_a_pair_that_cannot_be_settles_what_others_are():
    evidence = np.array([[0.0, 0.0, -900.0], [0.0, 0.0, 0.0], [-900.0, 0.0, 0.0]])
    np.testing.assert_allclose(hypotheses(evidence)[0], [0.5, 0.5, 0.0])
    np.testing.assert_allclose(hypotheses(evidence[:, [1, 2, 0]])[0], [0.5, 0.0, 0.5])


def test_what_does_not_look_alike_or_is_interchangeable_needs_no_telling_apart():
    assert not belief(task((0.06, 0.09), robot_radius=0.12)).needed
    assert belief(task((0.06, 0.065), robot_radius=0.12)).needed
    assert not belief(task(robot_radius=0.12, interchangeable=((0, 1),))).needed
    assert belief(task(interchangeable=((0, 1),))).needed
    assert not belief(task(interchangeable=((0, 1),)), robot_grey=-140.0, part_grey=-72.0).needed
    assert not alike(task((0.06, 0.09)), RearrangementConfig())[1, 2]


def test_the_robot_is_the_disc_that_moves_as_commanded():
    """Track 1 does; the names follow it, and the parts remain as alike as they were."""
    who = belief(task())
    shift = np.array([0.01, 0.0])
    for tick in range(6):
        moved = PLACES + np.outer([0.0, 1.0, 0.0], tick * shift)
        see(who, moved, shift=shift if tick else STILL)
    order = who.better()
    assert order is not None
    assert order[0] == 1
    who.rename(order)
    assert who.certainties[0] > 0.9999
    np.testing.assert_allclose(who.certainties[1:], [0.5, 0.5], atol=1e-3)
    assert who.robot_among == ()
    np.testing.assert_allclose(who.robot_position().position, [0.55, 0.0], atol=1e-6)


def test_discs_that_all_rest_stay_as_alike_as_they_were():
    who = belief(task())
    for _ in range(6):
        see(who)
    assert who.better() is None
    np.testing.assert_allclose(who.certainties, np.full(3, 1 / 3), atol=1e-9)
    assert who.robot_among == (0, 1)


def test_radii_a_millimetre_apart_are_told_apart_in_time_and_equal_ones_never():
    who = belief(task((0.057, 0.058), robot_radius=0.2))
    see(who, radii=(0.2, 0.058, 0.057))
    assert who.certainties[1] < 0.9
    for _ in range(200):
        see(who, radii=(0.2, 0.058, 0.057))
    order = who.better()
    assert order is not None
    assert order.tolist() == [0, 2, 1]
    same = belief(task((0.057, 0.057), robot_radius=0.2))
    for _ in range(200):
        see(same, radii=(0.2, 0.0571, 0.0569))
    assert same.better() is None
    assert same.certainties[1] == pytest.approx(0.5)


def test_starts_that_the_task_gives_tell_parts_apart():
    who = belief(task(robot_radius=0.2, starts=((-0.5, 0.3), (0.5, 0.0))))
    see(who, radii=(0.2, 0.08, 0.08))
    order = who.better()
    assert order is not None
    assert order.tolist() == [0, 2, 1]
    who.rename(order)
    assert who.certainties.min() > 0.999


@pytest.mark.parametrize("seen", [((60, 60, 60), (190, 60, 20), (30, 20, 180)), NONE])
def test_colours_tell_discs_apart_in_any_light_where_they_are_seen(seen):
    """The blue part is on the red one's track; the robot, whose colour nobody gave, has what is left."""
    who = belief(task(colours=(RED, BLUE)))
    for _ in range(3):
        see(who, colours=seen)
    order = who.better()
    if seen is NONE:
        assert order is None
        return
    assert order is not None
    assert order.tolist() == [0, 2, 1]
    who.rename(order)
    assert who.certainties.min() > 0.999


@pytest.mark.parametrize(("where", "sure"), [((1, 2), True), ((2, 1), False), (None, False)])
def test_two_that_were_lost_together_are_sure_only_where_they_were(where, sure):
    """At each other's places they may have been exchanged; elsewhere either may be either."""
    who = belief(task(robot_radius=0.2, starts=((0.5, 0.0), (-0.5, 0.3))))
    looks = (0.2, 0.08, 0.08)
    for _ in range(3):
        see(who, radii=looks)
    assert who.certainties.min() > 0.999
    see(who, radii=looks, missing=(1, 2), lost=(1, 2))
    after = PLACES[[0, *where]] if where else PLACES - np.outer([0, 1, 1], [0.0, 0.5])
    for _ in range(3):
        see(who, after, radii=looks)
    order = who.better()
    if order is not None:
        who.rename(order)
    if where is None:
        assert who.certainties[1:].max() == pytest.approx(0.5, abs=1e-6)
    elif sure:
        assert order is None
        assert who.certainties.min() > 0.999
    else:  # the discs of the tracks are exchanged: the names go with the places
        assert order is not None
        assert order.tolist() == [0, 2, 1]
