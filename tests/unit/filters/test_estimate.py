"""What weighted particles say: closed forms, independent oracles, and the kernels against their twins."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.filters.estimate import (
    mean_and_covariance,
    modes,
    pose_estimate,
    quantiles,
    turn_bins,
)
from dynpf.reference import bins as reference_bins
from dynpf.reference import estimate as reference_estimate
from dynpf.rng import generator
from dynpf.se2 import Floats, wrap_angle

CIRCLE = 2.0 * np.pi


def cloud(seed: int, count: int, at: tuple[float, float, float] = (0.0, 0.0, 0.0), sigma: float = 1.0) -> Floats:
    drawn = generator(seed, "test", 0).standard_normal((3, count)) * np.array([[sigma], [2.0 * sigma], [0.3 * sigma]])
    moved: Floats = drawn + np.array(at)[:, None]
    return moved.astype(np.float32)


def even(count: int) -> Floats:
    return np.full(count, 1.0 / count, dtype=np.float32)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    count=st.integers(1, 400),
    seed=st.integers(0, 10**6),
    x=st.floats(-1000.0, 1000.0),
    theta=st.floats(-np.pi, np.pi),
    sigma=st.floats(0.01, 3.0),
)
def test_kernel_and_twin_agree(count: int, seed: int, x: float, theta: float, sigma: float) -> None:
    particles = cloud(seed, count, (x, -x, theta), sigma)
    weights = (3.0 * generator(seed, "weights", 0).random(count)).astype(np.float32)
    mean, covariance = reference_estimate.pose_moments(particles[0], particles[1], particles[2], weights)
    found = pose_estimate(particles, weights)
    np.testing.assert_allclose(found.mean[:2], mean[:2], rtol=1e-12, atol=1e-12)
    # Sines are rounded to float32; the shorter their mean vector, the more that turns it.
    length = abs(np.sum(weights * np.exp(1j * particles[2]))) / weights.sum()
    assert abs(wrap_angle(found.mean[2] - mean[2])) < 1e-6 / length
    # Deviations and their products are rounded to float32; headings' also carry an error of up to 1e-6 from wrapping.
    sigmas = np.sqrt(np.diag(covariance)) + 3e-5
    tolerance = 5e-5 * np.outer(sigmas, sigmas) + 1e-6**2
    np.testing.assert_array_less(np.abs(found.covariance - covariance), tolerance)


def test_float64_particles_are_not_rounded() -> None:
    particles = cloud(1, 100).astype(np.float64) * 1e-9 + 1.0
    expected = np.cov(particles[:2], ddof=0)
    assert pose_estimate(particles, even(100)).covariance[:2, :2] == pytest.approx(expected, rel=1e-5, abs=0.0)


def test_moments_are_those_of_numpy_where_headings_do_not_wrap() -> None:
    particles, weights = cloud(2, 500), generator(2, "weights", 0).random(500).astype(np.float32)
    found = pose_estimate(particles, weights)
    assert found.mean[:2] == pytest.approx(np.average(particles[:2].astype(float), axis=1, weights=weights))
    assert found.covariance[:2, :2] == pytest.approx(np.cov(particles[:2], aweights=weights, ddof=0), rel=1e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_headings_are_averaged_across_the_cut(dtype: type[np.floating[Any]]) -> None:
    headings = np.array([np.pi - 0.1, -np.pi + 0.1, np.pi - 0.3, -np.pi + 0.3])
    particles = np.stack((np.zeros(4), np.zeros(4), headings)).astype(dtype)
    mean, covariance = pose_estimate(particles, np.full(4, 0.25, dtype=np.float32))
    assert abs(mean[2]) == pytest.approx(np.pi, abs=1e-6)
    assert covariance[2, 2] == pytest.approx((0.1**2 + 0.3**2) / 2, rel=1e-5)
    # Control: the plain mean lies on the other side.
    assert abs(headings.mean()) < 1e-9


def test_opposite_headings_have_no_mean_but_a_large_variance() -> None:
    particles = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, np.pi]], dtype=np.float32)
    mean, covariance = pose_estimate(particles, even(2))
    assert np.isfinite(mean).all()
    assert covariance[2, 2] == pytest.approx((np.pi / 2) ** 2, rel=1e-4)


def test_one_particle_and_all_weight_on_one_particle_are_that_particle() -> None:
    particles = cloud(3, 9, at=(300.0, -7.0, 1.0))
    weights = np.zeros(9, dtype=np.float32)
    weights[4] = 0.2
    for columns, share in ((particles[:, 4:5].copy(), even(1)), (particles, weights)):
        mean, covariance = pose_estimate(columns, share)
        np.testing.assert_allclose(mean, particles[:, 4], rtol=3e-7)
        assert np.abs(covariance).max() < 1e-12


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_is_not_finite_counts_as_absent(dtype: type[np.floating[Any]]) -> None:
    particles = cloud(4, 20).astype(dtype)
    weights = generator(4, "weights", 0).random(20).astype(np.float32)
    damaged, uneven = particles.copy(), weights.copy()
    damaged[0, 3], damaged[2, 7], uneven[11] = np.nan, np.inf, np.nan
    kept = np.setdiff1d(np.arange(20), [3, 7, 11])
    found, expected = pose_estimate(damaged, uneven), pose_estimate(particles[:, kept], weights[kept])
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    assert quantiles(damaged[0], uneven, 0.4) == quantiles(particles[0, np.r_[kept, 7]], weights[np.r_[kept, 7]], 0.4)
    assert sum(mode.mass for mode in modes(damaged, uneven, sparse=0.0, min_mass=0.0)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("particles", "weights"),
    [
        (np.zeros((3, 0), dtype=np.float32), np.zeros(0, dtype=np.float32)),
        (np.zeros((3, 2), dtype=np.float32), np.zeros(2, dtype=np.float32)),
        (np.full((3, 2), np.nan, dtype=np.float32), even(2)),
        (np.full((3, 2), np.nan), even(2)),
    ],
)
def test_without_a_finite_particle_of_weight_there_is_no_estimate(particles: Floats, weights: Floats) -> None:
    for function in (pose_estimate, mean_and_covariance, modes):
        with pytest.raises(ValueError, match="has weight"):
            function(particles, weights)


def test_generic_moments_take_any_number_of_rows() -> None:
    states, weights = generator(5, "test", 0).standard_normal((5, 60)), generator(5, "weights", 0).random(60)
    mean, covariance = mean_and_covariance(states, weights)
    assert mean == pytest.approx(np.average(states, axis=1, weights=weights))
    assert covariance == pytest.approx(np.cov(states, aweights=weights, ddof=0))
    states[4, 0] = np.nan
    assert mean_and_covariance(states, weights)[0] == pytest.approx(
        np.average(states[:, 1:], axis=1, weights=weights[1:])
    )


def test_two_places_are_two_modes_with_their_masses() -> None:
    left, right = cloud(6, 300, at=(-5.0, 0.0, 1.0), sigma=0.1), cloud(7, 700, at=(5.0, 1.0, -2.0), sigma=0.1)
    found = modes(np.concatenate([left, right], axis=1), even(1000), sparse=0.0)
    assert [mode.mass for mode in found] == pytest.approx([0.7, 0.3], rel=1e-5)
    for mode, part in zip(found, (right, left), strict=True):
        alone = pose_estimate(part, even(part.shape[1]))
        assert mode.mean == pytest.approx(alone.mean, abs=1e-5)
        assert mode.covariance == pytest.approx(alone.covariance, abs=1e-5)


def test_headings_apart_are_modes_apart_and_the_circle_closes() -> None:
    opposite = np.zeros((3, 4), dtype=np.float32)
    opposite[2] = [0.0, 0.0, np.pi - 0.01, 0.01 - np.pi]
    found = modes(opposite, even(4))
    assert [mode.mass for mode in found] == pytest.approx([0.5, 0.5])
    assert sorted(abs(mode.mean[2]) for mode in found) == pytest.approx([0.0, np.pi], abs=1e-5)


def test_stray_particles_do_not_join_two_modes() -> None:
    bridge = np.zeros((3, 21), dtype=np.float32)
    bridge[0] = np.linspace(-5.0, 5.0, 21)
    ends = np.repeat(bridge[:, [0, 20]], 500, axis=1)
    particles = np.concatenate([ends, bridge], axis=1)
    assert len(modes(particles, even(1021))) == 2
    assert len(modes(particles, even(1021), sparse=0.0)) == 1


def test_light_modes_are_left_out() -> None:
    particles = np.zeros((3, 10), dtype=np.float32)
    particles[0] = 3.0 * np.arange(10)
    assert len(modes(particles, even(10), min_mass=0.05)) == 10
    assert modes(particles, even(10), min_mass=0.2) == ()


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    count=st.integers(1, 400),
    seed=st.integers(0, 10**6),
    extent=st.floats(0.1, 20.0),
    bins=st.integers(1, 40),
    sparse=st.sampled_from([0.0, 0.1, 0.6]),
)
def test_cells_and_clusters_are_those_of_the_twins(
    count: int, seed: int, extent: float, bins: int, sparse: float
) -> None:
    rng = generator(seed, "test", 0)
    x, y, theta = (rng.uniform(-1.0, 1.0, (3, count)) * np.array([[extent], [extent], [7.0]])).astype(np.float32)
    weights = np.where(rng.random(count) < 0.1, 0.0, rng.random(count)).astype(np.float32)
    weights[rng.random(count) < 0.05] = np.nan
    weights[0] = 0.5
    x[rng.random(count) < 0.05] = np.nan
    x[0] = 1e30
    labels, masses = np.empty(count, dtype=np.int32), np.zeros(count)
    total = kernels.bins.clusters(x, y, theta, weights, 2.0, bins, sparse, labels, masses)
    expected, expected_masses, expected_total = reference_bins.clusters(x, y, theta, weights, 2.0, bins, sparse)
    np.testing.assert_array_equal(labels, expected)
    np.testing.assert_allclose(masses, expected_masses, rtol=1e-9)
    assert total == pytest.approx(expected_total, rel=1e-9)
    cells = kernels.bins.occupied(x, y, theta, weights, 2.0, 1.0, bins)
    assert cells == reference_bins.occupied(x, y, theta, weights, 2.0, 1.0, bins)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(count=st.integers(1, 60), seed=st.integers(0, 10**6), q=st.floats(0.0, 1.0))
def test_quantiles_are_those_of_the_inverted_distribution(count: int, seed: int, q: float) -> None:
    values, weights = generator(seed, "test", 0).random((2, count))
    found = quantiles(values, weights, (q, 0.0, 1.0))
    # The least value below and at which there is a share of q. Where q falls on a step, rounding decides on which side.
    shares = np.array([weights[values <= value].sum() for value in values]) / weights.sum()
    if np.abs(shares - q).min() > 1e-9:
        assert found[0] == values[shares >= q].min()
    assert found[1:].tolist() == [values.min(), values.max()]


def test_quantiles_refuse_shares_beyond_all() -> None:
    with pytest.raises(ValueError, match="from 0 to 1"):
        quantiles([1.0], [1.0], 1.1)


def test_a_whole_number_of_cells_makes_the_circle() -> None:
    assert [turn_bins(cell) for cell in (CIRCLE / 12, 1.0, 100.0)] == [12, 6, 1]
