"""Bounds: the Kalman filter attains them where all is linear and Gaussian, and nothing gets below them elsewhere."""

import numpy as np
import pytest

from dynpf.metrics.bounds import (
    covariance_bound,
    measurement_information,
    noiseless_information,
    posterior_information,
    rms_bound,
)
from dynpf.types import FloatArray

STEPS, SAMPLES = 20, 3
F = np.array([[1.0, 0.5, 0.0], [0.0, 0.9, 0.2], [0.1, 0.0, 1.0]])
H = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, 0.0]])
R = np.array([[0.4, 0.1], [0.1, 0.3]])
Q = np.array([[0.05, 0.01, 0.0], [0.01, 0.08, 0.02], [0.0, 0.02, 0.03]])
PRIOR = np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.1], [0.0, 0.1, 0.5]])


def over_time(matrix: FloatArray, samples: int = SAMPLES) -> FloatArray:
    return np.broadcast_to(matrix, (STEPS, samples, *matrix.shape))


def kalman_covariances(process: FloatArray) -> FloatArray:
    """Return the covariance after each reading, by the equations of the covariance filter."""
    covariances = [PRIOR]
    for _ in range(STEPS):
        predicted = F @ covariances[-1] @ F.T + process
        gain = predicted @ H.T @ np.linalg.inv(H @ predicted @ H.T + R)
        covariances.append((np.eye(3) - gain @ H) @ predicted)
    return np.array(covariances)


def information(process: FloatArray, samples: int = SAMPLES) -> FloatArray:
    gained = measurement_information(over_time(H, samples), R)
    return posterior_information(np.linalg.inv(PRIOR), over_time(F, samples), process, gained)


@pytest.mark.parametrize("process", [Q, over_time(Q), 1e-6 * Q])
def test_the_bound_of_a_linear_system_is_its_kalman_covariance(process: FloatArray) -> None:
    expected = kalman_covariances(process if process.ndim == 2 else Q)
    np.testing.assert_allclose(covariance_bound(information(process)), expected, rtol=0, atol=1e-10)


def test_the_bound_without_process_noise_is_the_kalman_covariance() -> None:
    """Both the form for one trajectory (PARTS eq. 3.38) and the general one, which need not invert Q."""
    gained = measurement_information(over_time(H), R)
    noiseless = noiseless_information(np.linalg.inv(PRIOR), over_time(F), gained)
    assert noiseless.shape == (STEPS + 1, SAMPLES, 3, 3)
    expected = kalman_covariances(np.zeros((3, 3)))
    for sample in range(SAMPLES):
        np.testing.assert_allclose(covariance_bound(noiseless[:, sample]), expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(covariance_bound(information(np.zeros((3, 3)))), expected, rtol=0, atol=1e-10)


def test_noise_in_some_rows_only_is_the_kalman_covariance_too() -> None:
    process = np.diag([0.0, 0.1, 0.0])
    np.testing.assert_allclose(covariance_bound(information(process)), kalman_covariances(process), rtol=0, atol=1e-10)


def test_singular_noise_with_transitions_that_differ_is_refused() -> None:
    transitions = over_time(F).copy()
    transitions[4, 1, 0, 0] += 0.1
    gained = measurement_information(over_time(H), R)
    with pytest.raises(ValueError, match="step 4: the process noise is singular"):
        posterior_information(np.linalg.inv(PRIOR), transitions, np.zeros((3, 3)), gained)


def test_transitions_and_noise_that_differ_are_averaged_as_the_recursion_says() -> None:
    """Scalars by hand: J+ = 1/Q - (E f / Q)^2 / (J + E f^2 / Q) + 1/R with f = 1 and 3."""
    transitions = np.array([1.0, 3.0]).reshape(1, 2, 1, 1)
    gained = np.full((1, 2, 1, 1), 1 / 0.25)
    found = posterior_information(np.array([[2.0]]), transitions, np.array([[0.5]]), gained)
    by_hand = 1 / 0.5 - (2.0 / 0.5) ** 2 / (2.0 + 5.0 / 0.5) + 4.0
    assert found[:, 0, 0] == pytest.approx([2.0, by_hand])
    noises = np.array([0.5, 0.1]).reshape(1, 2, 1, 1)
    found = posterior_information(np.array([[2.0]]), transitions, noises, gained)
    d11, d12, d22 = (1 / 0.5 + 9 / 0.1) / 2, -(1 / 0.5 + 3 / 0.1) / 2, (1 / 0.5 + 1 / 0.1) / 2 + 4.0
    assert found[1, 0, 0] == pytest.approx(d22 - d12**2 / (2.0 + d11))


def test_numbers_that_were_not_measured_and_readings_that_were_not_taken_add_nothing() -> None:
    observations = over_time(H).copy()
    observations[:, :, 1] = 0.0
    diagonal = np.diag(np.diag(R))
    alone = measurement_information(over_time(H[:1]), diagonal[:1, :1])
    np.testing.assert_allclose(measurement_information(observations, diagonal), alone)
    nothing = posterior_information(np.linalg.inv(PRIOR), over_time(F), Q, np.zeros((STEPS, SAMPLES, 3, 3)))
    np.testing.assert_allclose(covariance_bound(nothing[1]), F @ PRIOR @ F.T + Q)


def test_rms_is_over_the_chosen_rows() -> None:
    matrices = np.stack([np.diag([1 / 9.0, 1 / 16.0, 1 / 4.0]), np.eye(3)])
    np.testing.assert_allclose(rms_bound(matrices), [5.0, np.sqrt(2.0)])
    np.testing.assert_allclose(rms_bound(matrices, rows=(2,)), [2.0, 1.0])
    with pytest.raises(np.linalg.LinAlgError):
        rms_bound(np.zeros((3, 3)))


def test_no_filter_gets_below_the_bound_of_a_curved_measurement() -> None:
    """x' = x + noise seen as the angle atan(x): a grid filter, exact up to its spacing, stays above but near."""
    rng = np.random.default_rng(4)
    steps, samples, process, noise = 8, 1500, 0.05, 0.02
    truth = 0.7 * rng.standard_normal((1, samples))
    grid = np.linspace(-5.0, 5.0, 401)
    weights = np.repeat(np.exp(-0.5 * (grid / 0.7) ** 2)[:, None], samples, axis=1)
    kernel = np.exp(-0.5 * (grid[:, None] - grid[None, :]) ** 2 / process)
    slopes, errors = [], []
    for _ in range(steps):
        truth = truth + np.sqrt(process) * rng.standard_normal(truth.shape)
        reading = np.arctan(truth) + np.sqrt(noise) * rng.standard_normal(truth.shape)
        weights = (kernel @ weights) * np.exp(-0.5 * (reading - np.arctan(grid)[:, None]) ** 2 / noise)
        weights /= weights.sum(axis=0)
        errors.append(grid @ weights - truth[0])
        slopes.append((1.0 / (1.0 + truth**2)).reshape(samples, 1, 1))
    gained = measurement_information(np.array(slopes), np.array([[noise]]))
    transitions = np.ones((steps, samples, 1, 1))
    bound = rms_bound(posterior_information(np.array([[1 / 0.49]]), transitions, np.array([[process]]), gained), (0,))
    found = np.sqrt(np.mean(np.square(errors), axis=1))
    assert (found > 0.99 * bound[1:]).all()
    assert (found < 1.5 * bound[1:]).all()


def test_the_recursion_is_that_of_its_four_expectations() -> None:
    rng = np.random.default_rng(6)
    transitions = F + 0.3 * rng.standard_normal((STEPS, SAMPLES, 3, 3))
    scales = rng.uniform(0.5, 2.0, (STEPS, SAMPLES, 1, 1))
    gained = measurement_information(H + 0.2 * rng.standard_normal((STEPS, SAMPLES, 2, 3)), R)
    found = posterior_information(np.linalg.inv(PRIOR), transitions, scales * Q, gained)
    expected = [np.linalg.inv(PRIOR)]
    for step in range(STEPS):
        precisions = [np.linalg.inv(scale * Q) for scale in scales[step]]
        d11 = np.mean([f.T @ p @ f for f, p in zip(transitions[step], precisions, strict=True)], axis=0)
        d12 = -np.mean([f.T @ p for f, p in zip(transitions[step], precisions, strict=True)], axis=0)
        d22 = np.mean(precisions, axis=0) + gained[step].mean(axis=0)
        expected.append(d22 - d12.T @ np.linalg.inv(expected[-1] + d11) @ d12)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
