"""The optimal-proposal particle filter against the Kalman filter, which is exact where all is linear and Gaussian."""

import numpy as np
import pytest

from dynpf.filters import kalman, optimal
from dynpf.filters.resampling import effective_sample_size
from dynpf.rng import generator

PROCESS = np.array([[0.06, 0.02], [0.02, 0.05]])
NOISE = np.array([[0.2, -0.05], [-0.05, 0.3]])
CONTROL = np.array([0.4, -0.2])
I2 = np.eye(2)
N = 4000


def run(noise_of_filter, ticks=25):
    """Return the worst distance between the two filters' means in units of their Monte-Carlo standard error."""
    world = generator(5, "world", 0)
    truth = np.array([1.0, 2.0])
    measurement = truth + np.linalg.cholesky(NOISE) @ world.standard_normal(2)
    particles = optimal.draw_initial(measurement, NOISE, N, generator(5, "filter", 0))
    mean, covariance = measurement, NOISE
    worst, covariances = 0.0, None
    for tick in range(1, ticks):
        truth = truth + CONTROL + np.linalg.cholesky(PROCESS) @ world.standard_normal(2)
        measurement = truth + np.linalg.cholesky(NOISE) @ world.standard_normal(2)
        random = generator(5, "filter", tick)
        particles, _ = optimal.update(
            particles,
            particles.states + CONTROL,
            PROCESS,
            measurement=measurement,
            measurement_covariance=noise_of_filter,
            random=random,
        )
        predicted = kalman.predict(kalman.Gaussian(mean + CONTROL, covariance), I2, PROCESS)
        mean, covariance = kalman.update(predicted, measurement, I2, NOISE)
        found, covariances = optimal.mean_and_covariance(particles)
        standard_error = np.sqrt(np.diag(covariance) / effective_sample_size(particles.weights))
        worst = max(worst, float(np.max(np.abs(found - mean) / standard_error)))
        particles = optimal.resample_if_needed(particles, 2 / 3, random.random())
    return worst, covariances, covariance


def test_agrees_with_the_kalman_filter_within_monte_carlo_error():
    worst, found, expected = run(NOISE)
    assert worst < 6.0
    np.testing.assert_allclose(found, expected, atol=0.08 * expected.max())


def test_a_wrong_covariance_is_found_out():
    """Control: the test above would see a filter that believes twice the noise."""
    worst, _, _ = run(2.0 * NOISE)
    assert worst > 12.0


def test_log_likelihood_is_that_of_the_predictive_density():
    particles = optimal.Particles(np.array([[0.3, 0.1]]), np.ones(1))
    measurement = np.array([0.9, -0.4])
    _, log_likelihood = optimal.update(
        particles,
        particles.states,
        PROCESS,
        measurement=measurement,
        measurement_covariance=NOISE,
        random=generator(6, "filter", 0),
    )
    total = PROCESS + NOISE
    offset = measurement - particles.states[0]
    expected = -0.5 * (offset @ np.linalg.inv(total) @ offset) - np.log(2 * np.pi * np.sqrt(np.linalg.det(total)))
    assert log_likelihood == pytest.approx(expected, rel=1e-12)


def test_without_process_noise_the_particles_stay_on_their_predictions():
    particles = optimal.draw_initial(np.zeros(2), NOISE, 50, generator(7, "filter", 0))
    moved, _ = optimal.update(
        particles,
        particles.states + CONTROL,
        np.zeros((2, 2)),
        measurement=CONTROL,
        measurement_covariance=NOISE,
        random=generator(7, "filter", 1),
    )
    np.testing.assert_allclose(moved.states, particles.states + CONTROL)
    assert effective_sample_size(moved.weights) < 50


def test_an_impossible_measurement_keeps_the_weights():
    particles = optimal.Particles(np.zeros((3, 2)), np.array([0.5, 0.3, 0.2]))
    kept, log_likelihood = optimal.update(
        particles,
        particles.states,
        PROCESS,
        measurement=np.array([1e200, 0.0]),
        measurement_covariance=NOISE,
        random=generator(8, "filter", 0),
    )
    assert log_likelihood == -np.inf
    assert kept.weights.tolist() == [0.5, 0.3, 0.2]


def test_resamples_only_below_the_threshold():
    states = np.arange(6.0).reshape(3, 2)
    even = optimal.Particles(states, np.array([0.4, 0.3, 0.3]))
    assert optimal.resample_if_needed(even, 2 / 3, 0.5) is even
    uneven = optimal.Particles(states, np.array([0.9, 0.1, 0.0]))
    resampled = optimal.resample_if_needed(uneven, 2 / 3, 0.5)
    assert resampled.states.tolist() == [[0.0, 1.0]] * 3
    np.testing.assert_allclose(resampled.weights, 1 / 3)


def test_without_a_measurement_the_spread_grows_by_the_process_noise():
    particles = optimal.draw_initial(np.zeros(2), NOISE, 20_000, generator(9, "filter", 0))
    moved = optimal.propagate(particles, particles.states + CONTROL, PROCESS, generator(9, "filter", 1))
    mean, covariance = optimal.mean_and_covariance(moved)
    np.testing.assert_allclose(mean, CONTROL, atol=0.02)
    np.testing.assert_allclose(covariance, NOISE + PROCESS, atol=0.015)
