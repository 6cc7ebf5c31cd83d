"""The linear Kalman filter against closed forms."""

import numpy as np
import pytest

from dynpf.filters import kalman

I2 = np.eye(2)


def test_steady_state_of_a_random_walk():
    """P- = (Q + sqrt(Q^2 + 4 Q R)) / 2 solves the scalar Riccati equation."""
    process, noise = 0.06, 0.2
    mean, covariance = np.zeros(2), 9.0 * I2
    for _ in range(60):
        mean, covariance = kalman.predict(mean, covariance, I2, process * I2)
        predicted = covariance
        mean, covariance = kalman.update(mean, covariance, np.ones(2), I2, noise * I2)
    prior = (process + np.sqrt(process**2 + 4 * process * noise)) / 2
    np.testing.assert_allclose(predicted, prior * I2, rtol=1e-12)
    np.testing.assert_allclose(covariance, prior * noise / (prior + noise) * I2, rtol=1e-12)
    np.testing.assert_allclose(mean, 1.0)


def test_update_is_the_product_of_two_gaussians():
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    noise = np.array([[0.5, -0.1], [-0.1, 0.4]])
    mean, measurement = np.array([1.0, -1.0]), np.array([1.5, 0.5])
    updated, remaining = kalman.update(mean, covariance, measurement, I2, noise)
    information = np.linalg.inv(covariance) + np.linalg.inv(noise)
    np.testing.assert_allclose(remaining, np.linalg.inv(information), rtol=1e-12)
    expected = np.linalg.solve(information, np.linalg.solve(covariance, mean) + np.linalg.solve(noise, measurement))
    np.testing.assert_allclose(updated, expected, rtol=1e-12)


def test_what_is_not_observed_is_learnt_through_correlation():
    """A constant-velocity target of which only the position is seen: the velocity converges."""
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    observation = np.array([[1.0, 0.0]])
    mean, covariance = np.zeros(2), 100.0 * I2
    for tick in range(1, 30):
        mean, covariance = kalman.predict(mean, covariance, transition, 1e-9 * I2)
        mean, covariance = kalman.update(mean, covariance, np.array([0.5 * tick]), observation, np.array([[1e-4]]))
    assert mean[1] == pytest.approx(0.5, abs=1e-4)
    assert np.allclose(covariance, covariance.T)


def test_a_singular_innovation_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        kalman.update(np.zeros(2), np.zeros((2, 2)), np.ones(2), I2, np.zeros((2, 2)))
