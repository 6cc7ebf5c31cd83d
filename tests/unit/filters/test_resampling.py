"""Resampling schemes: unbiased, ordered in variance as theory says, and exact at the edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynpf.filters.cloud import uniform_cloud, weighted_cloud
from dynpf.filters.resampling import Multinomial, Residual, Stratified, Systematic, systematic
from dynpf.reference import cloud as reference
from dynpf.rng import Stream

SCHEMES = [Systematic(), Stratified(), Residual(), Multinomial()]
WEIGHTS = arrays(np.float32, st.integers(1, 300), elements=st.floats(0.0, 1.0, width=32)).filter(
    lambda w: w.sum() > 1e-6
)
UNIFORM = st.floats(0.0, 1.0, exclude_max=True)
UNEVEN = np.array([0.05, 0.0, 0.31, 0.17, 0.47], dtype=np.float32)


def copies(scheme, weights, trials, name="copies"):
    """Return how often each particle was taken, shape (trials, N)."""
    count = weights.size
    return np.array(
        [
            np.bincount(scheme.select(weights, count, Stream.of(1, "test", trial, name)), minlength=count)
            for trial in range(trials)
        ]
    )


@settings(derandomize=True, deadline=None)
@given(weights=WEIGHTS, uniform=UNIFORM, count=st.integers(1, 500))
def test_the_systematic_kernel_finds_the_teeth_of_its_reference(weights, uniform, count):
    chosen = systematic(weights, uniform, count)
    expected = reference.systematic(weights.astype(np.float64), uniform, count)
    assert np.all(np.diff(chosen) >= 0)
    # Both sum in float64. A tooth that falls on a boundary between two particles, up to rounding, may go to either.
    for tooth in np.flatnonzero(chosen != expected):
        cumulative = np.cumsum(weights.astype(np.float64)) / np.sum(weights, dtype=np.float64)
        low, high = sorted((chosen[tooth], expected[tooth]))
        assert cumulative[low] == pytest.approx((tooth + uniform) / count, abs=1e-12)
        assert cumulative[high - 1] == pytest.approx(cumulative[low], abs=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@settings(derandomize=True, deadline=None, max_examples=50)
@given(weights=WEIGHTS, step=st.integers(0, 10**6), count=st.integers(1, 400))
def test_every_scheme_takes_as_many_as_asked_and_none_of_weight_zero(scheme, weights, step, count):
    chosen = scheme.select(weights, count, Stream.of(2, "test", step))
    assert chosen.size == count
    assert np.all(np.diff(chosen) >= 0)
    assert np.all(weights[chosen] > 0.0)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_every_scheme_is_unbiased(scheme):
    trials = 4000
    taken = copies(scheme, UNEVEN, trials)
    error = taken.mean(axis=0) - 5 * UNEVEN
    # A multinomial count varies by at most N w (1 - w); the others by less.
    bound = 5.0 * np.sqrt(5 * UNEVEN * (1 - UNEVEN) / trials)
    assert np.all(np.abs(error) <= bound)
    # Control: a comb that always starts at the same place is biased.
    fixed = np.bincount(systematic(UNEVEN, 0.5), minlength=5) - 5 * UNEVEN
    assert np.any(np.abs(fixed) > bound)


def test_the_variance_of_each_scheme_is_what_theory_says():
    weights = np.exp(Stream.of(3, "test", 0).normals(1, 50)[0]).astype(np.float32)
    weights /= weights.sum()
    values = Stream.of(4, "test", 0).normals(1, 50)[0]
    trials = 3000
    variance = {
        type(scheme).__name__: np.var(copies(scheme, weights, trials, "variance") @ values / 50) for scheme in SCHEMES
    }
    mean = np.sum(weights * values)
    multinomial = np.sum(weights * (values - mean) ** 2) / 50
    whole = np.floor(50 * weights)
    rest = (50 * weights - whole) / np.sum(50 * weights - whole)
    remaining = 50 - whole.sum()
    residual = remaining * np.sum(rest * (values - np.sum(rest * values)) ** 2) / 50**2
    # The variance of a sample variance of nearly Gaussian values: 2 / (trials - 1), relative; four of its roots.
    tolerance = 4.0 * np.sqrt(2.0 / trials)
    assert variance["Multinomial"] == pytest.approx(multinomial, rel=tolerance)
    assert variance["Residual"] == pytest.approx(residual, rel=tolerance)
    # Douc, Cappe and Moulines (2005): residual and stratified never exceed multinomial.
    assert max(variance["Residual"], variance["Stratified"]) < variance["Multinomial"]
    assert variance["Systematic"] < variance["Residual"]


@settings(derandomize=True, deadline=None)
@given(weights=WEIGHTS, uniform=UNIFORM)
def test_systematic_takes_each_particle_its_expected_number_of_times_up_to_one(weights, uniform):
    taken = np.bincount(systematic(weights, uniform), minlength=weights.size)
    expected = weights.size * weights.astype(np.float64) / np.sum(weights, dtype=np.float64)
    assert np.all(np.abs(taken - expected) < 1.0 + 1e-9)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("weight", [1.0, 1e-300])
def test_one_particle_with_all_the_weight_takes_everything(scheme, weight):
    weights = np.zeros(7)
    weights[4] = weight
    assert scheme.select(weights, 7, Stream.of(5, "test", 0)).tolist() == [4] * 7


@pytest.mark.parametrize("uniform", [0.0, 0.5, np.nextafter(1.0, 0.0)])
def test_the_last_tooth_finds_the_last_particle_that_weighs(uniform):
    weights = np.zeros(1_000_000, dtype=np.float32)
    weights[:999_000] = np.float32(1e-6)
    chosen = systematic(weights, uniform)
    assert chosen[-1] == 998_999 or chosen[-1] == 998_998
    assert chosen.size == 1_000_000


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("weights", [np.zeros(3), np.array([np.nan, 1.0]), np.array([np.inf, 1.0]), np.empty(0)])
def test_weights_without_a_sum_are_refused(scheme, weights):
    with pytest.raises(ValueError, match="positive finite sum"):
        scheme.select(weights, 3, Stream.of(6, "test", 0))


def test_when_resampling_is_due():
    even = uniform_cloud(np.zeros((3, 4), dtype=np.float32))
    uneven, _ = weighted_cloud(even.particles, np.log(np.array([0.97, 0.01, 0.01, 0.01])))
    assert not Systematic(threshold=0.5).due(even)
    assert Systematic(threshold=0.5).due(uneven)
    assert not Systematic(threshold=0.2).due(uneven)
    assert Systematic(when="always").due(even)
    assert not Systematic(when="always", only_when_moving=True).due(even)
    assert Systematic(when="always", only_when_moving=True).due(even._replace(moved=True))
