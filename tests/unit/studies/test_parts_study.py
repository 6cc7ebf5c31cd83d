"""One run of the parts study: its measures, its seeds, and that filters are worth having."""

import math

import numpy as np
import pytest

from services.studies.parts import LAYOUTS, NOISE, RADII, layout_task, run_parts


def gap(name):
    goals, radii = np.array(LAYOUTS[name]), RADII[len(LAYOUTS[name])]
    return min(math.dist(goals[i], goals[j]) - radii[i] - radii[j] for i in range(len(goals)) for j in range(i))


def test_layouts_are_harder_the_smaller_their_gaps():
    for easy, intermediate, hard in (("3E", "3I", "3H"), ("6E", "6I", "6H")):
        assert gap(easy) > gap(intermediate) > gap(hard) >= 0.04


def test_without_noise_parts_come_home_almost_straight():
    run = run_parts(layout_task("3I"), 1)
    assert run.completed
    assert not run.collided
    assert 0.9 < run.npl < 1.3
    assert run.final_error < 0.005
    assert run.rpee == run.ppee == 0.0


def test_a_filter_lowers_the_error_and_a_seed_fixes_the_run():
    given = {"variance": NOISE["high"], "max_ticks": 150}
    task = layout_task("3I")
    raw, filtered = run_parts(task, 1, **given), run_parts(task, 1, particles=100, **given)
    # The mean length of a two-dimensional Gaussian is sqrt(pi / 2) standard deviations.
    assert raw.rpee == pytest.approx(math.sqrt(NOISE["high"] * math.pi / 2.0), rel=0.2)
    assert filtered.rpee < 0.7 * raw.rpee
    assert filtered.ppee < 0.7 * raw.ppee
    assert run_parts(task, 1, particles=100, **given) == filtered
    assert run_parts(task, 2, particles=100, **given) != filtered


def test_a_run_that_is_cut_short_is_not_complete():
    assert not run_parts(layout_task("3I"), 1, max_ticks=50).completed
