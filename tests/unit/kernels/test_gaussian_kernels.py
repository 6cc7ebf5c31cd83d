"""Kalman filters' and guided proposals' kernels against the formulas in plain NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.filters import kalman
from dynpf.filters.estimate import weighted_covariance
from dynpf.filters.kalman import Gaussian
from dynpf.portable import SingularMatrixError
from dynpf.reference import proposal as reference
from dynpf.types import Floats

SIZES = {"size": st.integers(1, 6), "rows": st.integers(1, 8), "seed": st.integers(0, 10**6)}


def positive(size: int, random: np.random.Generator) -> np.ndarray:
    factor = random.standard_normal((size, size + 1))
    return factor @ factor.T + 0.1 * np.eye(size)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(**SIZES)
def test_a_step_of_the_kalman_filter_is_that_of_the_textbooks(size: int, rows: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    belief = Gaussian(random.standard_normal(size), positive(size, random))
    transition, process = random.standard_normal((size, size)), positive(size, random)
    observation, noise, z = random.standard_normal((rows, size)), positive(rows, random), random.standard_normal(rows)

    predicted = kalman.predict(belief, transition, process)
    assert predicted.mean == pytest.approx(transition @ belief.mean, rel=1e-10, abs=1e-12)
    prior = transition @ belief.covariance @ transition.T + process
    assert predicted.covariance == pytest.approx(prior, rel=1e-10, abs=1e-12)

    spread = observation @ prior @ observation.T + noise
    weight = prior @ observation.T @ np.linalg.inv(spread)
    innovation = z - observation @ predicted.mean
    assert kalman.gain(prior, observation, noise) == pytest.approx(weight, rel=1e-6, abs=1e-8)
    nis = innovation @ np.linalg.solve(spread, innovation)
    assert kalman.judged(innovation, spread, None).nis == pytest.approx(nis, rel=1e-8)
    updated = kalman.update(predicted, z, observation, noise)
    assert updated.mean == pytest.approx(predicted.mean + weight @ innovation, rel=1e-6, abs=1e-7)
    remainder = np.eye(size) - weight @ observation
    posterior = remainder @ prior @ remainder.T + weight @ noise @ weight.T
    assert updated.covariance == pytest.approx(posterior, rel=1e-5, abs=1e-7)
    assert kalman.joseph(prior, weight, observation, noise) == pytest.approx(posterior, rel=1e-9, abs=1e-11)
    for covariance in (predicted.covariance, updated.covariance):
        assert np.array_equal(covariance, covariance.T)


EYE, ONES = np.eye(2), np.ones(2)
BELIEF = Gaussian(ONES, EYE)
MISFITS: dict[str, Callable[[], Any]] = {
    "transition": lambda: kalman.predict(BELIEF, np.ones((3, 2)), EYE),
    "process": lambda: kalman.predict(BELIEF, EYE, np.eye(3)),
    "observation": lambda: kalman.corrected(BELIEF, ONES, np.ones((2, 3)), EYE),
    "innovation": lambda: kalman.corrected(BELIEF, np.ones(3), EYE, EYE),
    "noise": lambda: kalman.gain(EYE, EYE, np.eye(3)),
    "gain": lambda: kalman.joseph(EYE, np.ones((2, 3)), EYE, EYE),
    "spread": lambda: kalman.judged(np.ones(3), EYE, None),
    "covariance": lambda: kalman.symmetric_offsets(np.ones((2, 3)), 1.0),
}


@pytest.mark.parametrize("what", MISFITS)
def test_matrices_that_do_not_fit_are_refused(what: str) -> None:
    with pytest.raises(ValueError, match=r"shape .*(expected|do not fit)"):
        MISFITS[what]()


def test_an_angle_that_the_state_has_not_is_refused() -> None:
    with pytest.raises(IndexError, match="angles"):
        kalman.predicted(BELIEF, ONES, EYE, EYE, np.array([2]))


def test_an_innovation_without_a_distance_is_refused_or_not_used() -> None:
    with pytest.raises(SingularMatrixError, match="no inverse"):
        kalman.judged(ONES, np.zeros((2, 2)), None)
    assert not kalman.judged(np.array([np.nan, 1.0]), EYE, None).used
    assert not kalman.judged(ONES, np.full((2, 2), np.inf), 9.0).used


@settings(deadline=None, max_examples=30, derandomize=True)
@given(**SIZES, count=st.sampled_from([1, 7, 300]))
def test_what_readings_leave_of_the_noise_is_that_of_the_textbooks(size: int, rows: int, seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    factors = random.standard_normal((size, size, count))
    process = np.einsum("ikn,jkn->ijn", factors, factors)
    root = np.empty_like(process)
    kernels.proposal.roots(process, root)
    assert np.einsum("ikn,jkn->ijn", root, root) == pytest.approx(process, rel=1e-9, abs=1e-6)

    noise = positive(rows, random) if seed % 2 else np.diag(random.uniform(0.1, 2.0, rows))
    jacobian, innovation = random.standard_normal((rows, size, count)), random.standard_normal((rows, count))
    precision, pull, log_density = np.zeros_like(process), np.zeros((size, count)), np.zeros(count)
    log_peak = -0.5 * np.linalg.slogdet(2.0 * np.pi * noise)[1]
    kernels.proposal.add_reading(
        root, jacobian, innovation, np.linalg.inv(noise), log_peak, precision, pull, log_density
    )
    told, pulled, density = reference.information(root, jacobian, innovation, noise)
    assert precision == pytest.approx(told, rel=1e-8, abs=1e-9)
    assert pull == pytest.approx(pulled, rel=1e-8, abs=1e-9)
    assert log_density == pytest.approx(density, rel=1e-8)

    precision += np.eye(size)[:, :, None]
    standard = random.standard_normal((size, count)).astype(np.float32)
    expected, drawn = random.standard_normal((size, count)), np.empty((size, count))
    gain, log_determinant, log_ratio = np.empty((3, count))
    kernels.proposal.draw(expected, root, precision, pull, standard, drawn, gain, log_determinant, log_ratio)
    noise_drawn, squared, determinant = reference.draw(precision, pull, standard)
    moved = expected + np.einsum("den,en->dn", root, noise_drawn)
    assert drawn == pytest.approx(moved, rel=1e-7, abs=1e-7)
    assert gain == pytest.approx(squared, rel=1e-7, abs=1e-9)
    assert log_determinant == pytest.approx(determinant, rel=1e-9, abs=1e-9)
    before = 0.5 * np.sum(standard.astype(np.float64) ** 2 - noise_drawn**2, axis=0)
    assert log_ratio == pytest.approx(before - determinant, rel=1e-6, abs=1e-6)


def test_a_direction_without_noise_has_a_root_of_zero() -> None:
    process = np.zeros((3, 3, 2))
    process[0, 0], process[0, 1], process[1, 0], process[1, 1] = 4.0, 2.0, 2.0, 1.0  # the second row is half the first
    root = np.empty_like(process)
    kernels.proposal.roots(process, root)
    assert root[..., 1] == pytest.approx(np.array([[2.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))


@pytest.mark.parametrize("count", [1, 127, 1000])
@pytest.mark.parametrize("types", [(np.float32, np.float32), (np.float64, np.float32), (np.float64, np.float64)])
def test_a_covariance_is_the_weighted_sum_of_outer_products(count: int, types: tuple[type, type]) -> None:
    random = np.random.default_rng(count)
    deviation: Floats = random.standard_normal((4, count)).astype(types[0])
    weights: Floats = random.random(count).astype(types[1])
    expected = np.einsum("n,in,jn->ij", weights.astype(np.float64), deviation, deviation, dtype=np.float64)
    assert weighted_covariance(deviation, weights) == pytest.approx(expected, rel=1e-12, abs=1e-12)
