"""The linear Kalman filter against closed forms, and the root of a covariance."""

import numpy as np
import pytest

from dynpf.filters import kalman
from dynpf.filters.kalman import Gaussian
from dynpf.portable import SingularMatrixError

I2 = np.eye(2)


def test_steady_state_of_a_random_walk():
    """P- = (Q + sqrt(Q^2 + 4 Q R)) / 2 solves the scalar Riccati equation."""
    process, noise = 0.06, 0.2
    belief = Gaussian(np.zeros(2), 9.0 * I2)
    for _ in range(60):
        predicted = kalman.predict(belief, I2, process * I2)
        belief = kalman.update(predicted, np.ones(2), I2, noise * I2)
    prior = (process + np.sqrt(process**2 + 4 * process * noise)) / 2
    np.testing.assert_allclose(predicted.covariance, prior * I2, rtol=1e-12)
    np.testing.assert_allclose(belief.covariance, prior * noise / (prior + noise) * I2, rtol=1e-12)
    np.testing.assert_allclose(belief.mean, 1.0)


def test_update_is_the_product_of_two_gaussians():
    belief = Gaussian(np.array([1.0, -1.0]), np.array([[2.0, 0.6], [0.6, 1.0]]))
    noise = np.array([[0.5, -0.1], [-0.1, 0.4]])
    measurement = np.array([1.5, 0.5])
    updated = kalman.update(belief, measurement, I2, noise)
    information = np.linalg.inv(belief.covariance) + np.linalg.inv(noise)
    np.testing.assert_allclose(updated.covariance, np.linalg.inv(information), rtol=1e-12)
    told = np.linalg.solve(belief.covariance, belief.mean) + np.linalg.solve(noise, measurement)
    np.testing.assert_allclose(updated.mean, np.linalg.solve(information, told), rtol=1e-12)


def test_what_is_not_observed_is_learnt_through_correlation():
    """A constant-velocity target of which only the position is seen: the velocity converges."""
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    observation = np.array([[1.0, 0.0]])
    belief = Gaussian(np.zeros(2), 100.0 * I2)
    for tick in range(1, 30):
        belief = kalman.predict(belief, transition, 1e-9 * I2)
        belief = kalman.update(belief, np.array([0.5 * tick]), observation, np.array([[1e-4]]))
        assert (belief.covariance == belief.covariance.T).all()
    assert belief.mean[1] == pytest.approx(0.5, abs=1e-4)


def test_a_singular_innovation_is_refused():
    with pytest.raises(SingularMatrixError, match="no inverse"):
        kalman.update(Gaussian(np.zeros(2), np.zeros((2, 2))), np.ones(2), I2, np.zeros((2, 2)))


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_offsets_stand_for_the_covariance_singular_or_not(rank):
    factor = np.random.default_rng(rank).standard_normal((3, rank))
    covariance = factor @ factor.T
    offsets = kalman.symmetric_offsets(covariance, 3.0)
    assert offsets.shape == (3, 6)
    np.testing.assert_allclose(offsets @ offsets.T / 6.0, covariance, atol=1e-14)
    np.testing.assert_allclose(offsets.sum(axis=1), 0.0, atol=1e-14)
