"""Linear observations with Gaussian noise: the density, the Gaussian methods, and what tells nothing."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dynpf.measurement import LinearMeasurement, Observation

H = [[1.0, 0.0, 0.5, 0.0], [0.0, 2.0, 0.0, -1.0]]
R = [[0.5, 0.2], [0.2, 0.4]]
STATES = np.random.Generator(np.random.Philox(key=1)).standard_normal((4, 9))
Z = Observation(np.array([0.3, -1.0]))


def test_the_log_likelihood_is_the_gaussian_density() -> None:
    expected = [multivariate_normal.logpdf(Z.z, np.array(H) @ state, R) for state in STATES.T]
    assert LinearMeasurement(H, R).log_likelihood(STATES, Z) == pytest.approx(expected, rel=1e-12)


def test_one_number_of_one_state() -> None:
    likelihood = LinearMeasurement([2.0], 0.25).log_likelihood(np.array([[1.0]]), Observation(np.array([2.5])))
    assert likelihood == pytest.approx([multivariate_normal.logpdf(2.5, 2.0, 0.25)])


def test_gaussian_methods_are_z_minus_hx_h_and_r() -> None:
    model = LinearMeasurement(H, R)
    assert model.innovation(STATES, Z) == pytest.approx(Z.z[:, None] - np.array(H) @ STATES)
    jacobian = model.jacobian(STATES, Z)
    assert jacobian.shape == (2, 4, 9)
    assert (jacobian == np.array(H)[:, :, None]).all()
    assert model.noise(Z).tolist() == R


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_result_has_the_states_precision(dtype: type[np.floating[Any]]) -> None:
    model, states = LinearMeasurement(H, R), STATES.astype(dtype)
    assert model.log_likelihood(states, Z).dtype == dtype
    assert model.innovation(states, Z).dtype == dtype
    assert model.jacobian(states, Z).dtype == dtype


@pytest.mark.parametrize("z", [[np.nan, 0.0], [0.0, np.inf], []])
def test_an_observation_that_is_not_finite_or_empty_tells_nothing(z: list[float]) -> None:
    model, weights = LinearMeasurement(H, R), np.full(9, 1.0 / 9.0)
    assert model.admit(STATES, weights, Observation(np.array(z))) is None
    assert model.log_likelihood(STATES, Observation(np.array(z))).tolist() == [0.0] * 9
    assert model.admit(STATES, weights, Z) is Z


def test_batches_of_columns_have_the_bits_of_the_whole() -> None:
    model = LinearMeasurement(H, R)
    halves = [model.log_likelihood(piece, Z) for piece in np.split(STATES, [1, 4], axis=1)]
    assert np.concatenate(halves).tobytes() == model.log_likelihood(STATES, Z).tobytes()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="for 2 rows"):
        LinearMeasurement(H, [[1.0]])
    with pytest.raises(ValueError, match="not symmetric"):
        LinearMeasurement(H, [[1.0, 0.5], [0.0, 1.0]])
    with pytest.raises(ValueError, match="not positive definite"):
        LinearMeasurement(H, np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"observation of shape \(3,\)"):
        LinearMeasurement(H, R).log_likelihood(STATES, Observation(np.zeros(3)))
    with pytest.raises(ValueError):
        LinearMeasurement(H, R).log_likelihood(STATES[:3], Z)
