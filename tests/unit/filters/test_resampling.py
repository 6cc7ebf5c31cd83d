"""Weights and systematic resampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynpf.filters.resampling import effective_sample_size, normalize_log_weights, systematic
from dynpf.rng import generator

WEIGHTS = arrays(np.float64, st.integers(1, 40), elements=st.floats(0.0, 1.0)).filter(lambda w: w.sum() > 1e-9)
UNIFORM = st.floats(0.0, 1.0, exclude_max=True)


@settings(derandomize=True, deadline=None)
@given(weights=WEIGHTS, uniform=UNIFORM)
def test_each_particle_is_taken_its_expected_number_of_times_up_to_one(weights, uniform):
    taken = np.bincount(systematic(weights, uniform), minlength=weights.size)
    expected = weights.size * weights / weights.sum()
    assert taken.sum() == weights.size
    assert np.all(np.abs(taken - expected) < 1.0 + 1e-9)
    assert np.all(taken[weights == 0.0] == 0)


def test_is_unbiased_over_the_uniform():
    weights = np.array([0.05, 0.0, 0.31, 0.17, 0.47])
    draws = generator(1, "test", 0).random(4000)
    taken = np.mean([np.bincount(systematic(weights, u), minlength=5) for u in draws], axis=0)
    np.testing.assert_allclose(taken, 5 * weights, atol=0.03)
    # Control: a comb that always starts at the same place is biased.
    assert np.abs(np.bincount(systematic(weights, 0.5), minlength=5) - 5 * weights).max() > 0.1


def test_takes_as_many_as_asked():
    assert systematic(np.array([0.5, 0.5]), 0.3, count=6).tolist() == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("uniform", [0.0, 0.5, np.nextafter(1.0, 0.0)])
def test_one_heavy_particle_takes_everything(uniform):
    weights = np.zeros(7)
    weights[4] = 1e-300
    assert systematic(weights, uniform).tolist() == [4] * 7


@pytest.mark.parametrize("weights", [np.zeros(3), np.array([np.nan, 1.0]), np.array([np.inf, 1.0]), np.empty(0)])
def test_weights_without_a_sum_are_refused(weights):
    with pytest.raises(ValueError, match="positive finite sum"):
        systematic(weights, 0.5)


def test_effective_sample_size_at_its_extremes():
    assert effective_sample_size(np.full(8, 1 / 8)) == pytest.approx(8.0)
    assert effective_sample_size(np.eye(8)[3]) == 1.0


def test_normalization_survives_weights_that_underflow():
    weights, log_sum = normalize_log_weights(np.array([-2000.0, -2000.0 + np.log(3.0)]))
    np.testing.assert_allclose(weights, [0.25, 0.75])
    assert log_sum == pytest.approx(-2000.0 + np.log(4.0))


def test_all_impossible_gives_uniform_weights_and_says_so():
    weights, log_sum = normalize_log_weights(np.array([-np.inf, np.nan]))
    assert weights.tolist() == [0.5, 0.5]
    assert log_sum == -np.inf


def test_nan_is_impossible_and_infinity_takes_everything():
    assert normalize_log_weights(np.array([np.nan, 0.0]))[0].tolist() == [0.0, 1.0]
    assert normalize_log_weights(np.array([np.inf, 0.0, np.inf]))[0].tolist() == [0.5, 0.0, 0.5]
    with pytest.raises(ValueError, match="no particles"):
        normalize_log_weights(np.empty(0))
