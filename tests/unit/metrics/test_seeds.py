"""Figures over runs against SciPy's and by hand."""

import math

import numpy as np
import pytest
from scipy import stats

from dynpf.metrics import seeds

NAN = math.nan


def test_spread() -> None:
    found = seeds.spread(np.append(np.arange(101.0), NAN))
    assert found == (5.0, 25.0, 50.0, 75.0, 95.0, 101)
    assert seeds.spread(np.array([NAN])).runs == 0
    assert math.isnan(seeds.spread(np.array([NAN])).median)


@pytest.mark.parametrize("count", [2, 3, 10, 101])
def test_the_interval_of_the_mean_is_student_s(count: int) -> None:
    values = np.random.default_rng(count).gamma(2.0, size=count)
    found = seeds.mean(np.append(values, NAN), 0.9)
    expected = stats.t.interval(0.9, count - 1, loc=values.mean(), scale=stats.sem(values))
    assert (found.low, found.high) == pytest.approx(expected, rel=1e-10)
    assert found.mean == pytest.approx(values.mean())
    assert found.runs == count


def test_one_run_says_nothing_about_the_spread_and_none_nothing_at_all() -> None:
    assert seeds.mean(np.array([2.0])) == (2.0, -math.inf, math.inf, 1)
    nothing = seeds.mean(np.empty(0))
    assert math.isnan(nothing.mean)
    assert nothing.runs == 0


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (10, 10), (7, 10), (1, 1), (499, 500)])
def test_the_interval_of_a_proportion_is_wilson_s(successes: int, trials: int) -> None:
    expected = stats.binomtest(successes, trials).proportion_ci(0.99, method="wilson")
    found = seeds.proportion(successes, trials, 0.99)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=1e-10, abs=1e-15)
    assert found.rate == successes / trials


def test_proportions_of_nothing_and_of_too_much() -> None:
    assert seeds.proportion(0, 0)[1:] == (0.0, 1.0)
    with pytest.raises(ValueError, match="successes = 3, trials = 2"):
        seeds.proportion(3, 2)
