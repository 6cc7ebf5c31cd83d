"""Weights in the log domain: exact where float32 allows it, and defined where nothing is left of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dynpf.filters.cloud import effective_sample_size, gathered, normalized_weights, uniform_cloud, weighted_cloud
from dynpf.reference import cloud as reference
from dynpf.rng import Stream

LOG_WEIGHTS = arrays(np.float32, st.integers(1, 100), elements=st.floats(-80.0, 80.0, width=32))


def cloud_of(log_weights):
    log_weights = np.asarray(log_weights)
    return weighted_cloud(np.zeros((3, log_weights.size), dtype=np.float32), log_weights)


@settings(derandomize=True, deadline=None)
@given(log_weights=LOG_WEIGHTS)
def test_the_kernel_agrees_with_its_reference(log_weights):
    cloud, log_sum = cloud_of(log_weights)
    weights, expected_log_sum, n_eff = reference.normalized(log_weights.astype(np.float64))
    # The difference to the largest is rounded to float32 (2^-24 of at most 160), exp adds two units in the last place.
    np.testing.assert_allclose(cloud.weights, weights, rtol=160 * 2.0**-24 + 4 * 2.0**-24, atol=1e-37)
    assert log_sum == pytest.approx(expected_log_sum, abs=2e-5)
    assert cloud.n_eff == pytest.approx(n_eff, rel=1e-4)
    assert np.sum(cloud.weights, dtype=np.float64) == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(np.exp(cloud.log_weights.astype(np.float64)), weights, rtol=5e-5, atol=1e-37)


@settings(derandomize=True, deadline=None)
@given(log_weights=LOG_WEIGHTS, shift=st.floats(-1e9, 1e9))
def test_weights_do_not_depend_on_a_factor_common_to_all(log_weights, shift):
    plain, _ = cloud_of(log_weights.astype(np.float64))
    shifted, _ = cloud_of(log_weights.astype(np.float64) + shift)
    np.testing.assert_allclose(shifted.weights, plain.weights, rtol=1e-6 * max(abs(shift), 1e2), atol=1e-37)


def test_weights_that_would_underflow():
    weights, log_sum = normalized_weights(np.array([-2000.0, -2000.0 + np.log(3.0)]))
    np.testing.assert_allclose(weights, [0.25, 0.75], rtol=1e-6)
    assert log_sum == pytest.approx(-2000.0 + np.log(4.0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_is_not_a_weight(dtype):
    nan, inf = np.nan, np.inf
    for log_weights, expected, expected_log_sum in (
        ([-inf, nan], [0.5, 0.5], -inf),
        ([nan, 0.0], [0.0, 1.0], 0.0),
        ([inf, 0.0, inf], [0.5, 0.0, 0.5], inf),
        ([nan], [1.0], -inf),
        ([-3.0], [1.0], -3.0),
    ):
        cloud, log_sum = cloud_of(np.array(log_weights, dtype=dtype))
        assert cloud.weights.tolist() == expected
        assert log_sum == pytest.approx(expected_log_sum)


def test_a_cloud_without_particles_is_refused():
    with pytest.raises(ValueError, match="at least one particle"):
        cloud_of(np.empty(0, dtype=np.float32))
    with pytest.raises(ValueError, match="at least one particle"):
        uniform_cloud(np.empty((3, 0), dtype=np.float32))


def test_effective_sample_size_at_its_extremes():
    assert effective_sample_size(np.full(8, 1 / 8)) == pytest.approx(8.0)
    assert effective_sample_size(np.eye(8)[3]) == 1.0
    assert cloud_of(np.zeros(1000, dtype=np.float32))[0].n_eff == pytest.approx(1000.0, rel=1e-6)


def test_survivors_are_copies():
    particles = Stream.of(1, "test", 0).normals(5, 40)
    chosen = np.array([0, 0, 3, 39], dtype=np.int32)
    assert np.array_equal(gathered(particles, chosen), particles[:, chosen])
