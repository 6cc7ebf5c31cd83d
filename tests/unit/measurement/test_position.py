"""Positions measured directly: the Gaussian density, its Gaussian methods, and what tells nothing."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dynpf.measurement import GaussianPosition, GaussianPositionParams, Position

PARTICLES = np.array([[0.0, 0.1, 2.0], [3.0, 2.9, -1.0], [0.0, -0.1, 3.0]])
SKEWED = GaussianPositionParams(covariance=(0.09, 0.03, 0.04))


@pytest.mark.parametrize(
    ("params", "covariance"),
    [(GaussianPositionParams(sigma=0.3), np.eye(2) * 0.09), (SKEWED, [[0.09, 0.03], [0.03, 0.04]])],
)
def test_the_log_likelihood_is_the_gaussian_density(params: GaussianPositionParams, covariance: np.ndarray) -> None:
    reading = Position(0.2, 2.8)
    expected = [multivariate_normal.logpdf([0.2, 2.8], mean, covariance) for mean in PARTICLES[:2].T]
    model = GaussianPosition(params)
    assert model.log_likelihood(PARTICLES, reading) == pytest.approx(expected, rel=1e-12)
    assert model.noise(reading) == pytest.approx(np.array(covariance))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_result_has_the_particles_precision(dtype: type[np.floating[Any]]) -> None:
    model, particles = GaussianPosition(SKEWED), PARTICLES.astype(dtype)
    for reading in (Position(0.2, 2.8), Position(math.nan, 0.0)):
        assert model.log_likelihood(particles, reading).dtype == dtype
    assert model.innovation(particles, Position(0.2, 2.8)).dtype == dtype
    assert model.jacobian(particles, Position(0.2, 2.8)).dtype == dtype


def test_the_jacobian_is_that_of_finite_differences() -> None:
    model, reading, states = GaussianPosition(SKEWED), Position(0.2, 2.8), np.vstack((PARTICLES, PARTICLES[:1]))
    jacobian = model.jacobian(states, reading)
    assert jacobian.shape == (2, 4, 3)
    for row in range(4):
        step = np.eye(4)[:, row : row + 1]
        change = model.innovation(states + step, reading) - model.innovation(states - step, reading)
        assert jacobian[:, row] == pytest.approx(-change / 2.0)


@pytest.mark.parametrize("reading", [Position(math.nan, 0.0), Position(0.0, math.nan), Position(math.inf, 0.0)])
def test_a_position_that_is_not_finite_tells_nothing(reading: Position) -> None:
    model, weights = GaussianPosition(SKEWED), np.full(3, 1.0 / 3.0)
    assert model.admit(PARTICLES, weights, reading) is None
    assert model.log_likelihood(PARTICLES, reading).tolist() == [0.0, 0.0, 0.0]
    good = Position(0.0, 0.0)
    assert model.admit(PARTICLES, weights, good) is good


def test_a_particle_far_off_the_map_or_not_finite_is_impossible() -> None:
    far_off = np.array([[1e30, np.inf, np.nan], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=np.float32)
    for particle in np.split(far_off, 3, axis=1):
        likelihood = GaussianPosition(SKEWED).log_likelihood(particle, Position(0.0, 0.0))
        assert likelihood.shape == (1,)
        assert not likelihood[0] > -np.inf


def test_batches_of_columns_have_the_bits_of_the_whole() -> None:
    particles = np.linspace(-3.0, 4.0, 3 * 101, dtype=np.float32).reshape(3, 101)
    model, reading = GaussianPosition(SKEWED), Position(0.2, 2.8)
    halves = [model.log_likelihood(piece, reading) for piece in np.split(particles, [37], axis=1)]
    assert np.concatenate(halves).tobytes() == model.log_likelihood(particles, reading).tobytes()


def test_noise_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="positive definite"):
        GaussianPosition(GaussianPositionParams(covariance=(1.0, 2.0, 1.0)))
    with pytest.raises(ValueError, match=r"GaussianPositionParams.sigma = 0.0"):
        GaussianPosition(GaussianPositionParams(sigma=0.0))
