"""Linear motion with Gaussian noise: products, singular noise, and matrices that do not fit."""

import numpy as np
import pytest

from dynpf.motion import LinearGaussian, LinearGaussianParams
from dynpf.rng import Stream

STREAM = Stream.of(1, "test", 0, "motion")
IDENTITY = ((1.0, 0.0), (0.0, 1.0))
# Constant velocity, pushed by accelerations that last a step of 0.5 s: noise of rank one.
STEP = 0.5
CONSTANT_VELOCITY = LinearGaussianParams(
    transition=((1.0, STEP), (0.0, 1.0)),
    noise=((0.25 * STEP**4, 0.5 * STEP**3), (0.5 * STEP**3, STEP**2)),
    input=((0.5 * STEP**2,), (STEP,)),
)


def test_states_are_multiplied_and_pushed() -> None:
    model = LinearGaussian(CONSTANT_VELOCITY)
    states = np.random.default_rng(1).standard_normal((2, 100))
    transition, push = np.array(CONSTANT_VELOCITY.transition), np.array(CONSTANT_VELOCITY.input)
    assert model.expected(states, None) == pytest.approx(transition @ states, abs=1e-14)
    assert model.expected(states, np.array([3.0])) == pytest.approx(transition @ states + 3.0 * push, abs=1e-14)
    assert model.particles(states, STREAM) is states


def test_noise_of_rank_one_stays_on_its_line() -> None:
    noise = LinearGaussian(CONSTANT_VELOCITY).propagate(np.zeros((2, 200_000)), None, STREAM)
    assert noise[0] == pytest.approx(0.5 * STEP * noise[1], abs=1e-12)
    assert np.cov(noise) == pytest.approx(np.array(CONSTANT_VELOCITY.noise), rel=5 * np.sqrt(2) / 447)


@pytest.mark.parametrize(
    "matrix",
    [((1.0, 2.0), (2.0, 1.0)), ((0.0, 1.0), (1.0, 0.0)), ((-1.0, 0.0), (0.0, 1.0)), ((1.0, 0.0), (0.0, -1e-6))],
)
def test_a_matrix_with_a_negative_eigenvalue_is_no_covariance(matrix: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(ValueError, match=r"noise = .*negative eigenvalue"):
        LinearGaussian(LinearGaussianParams(transition=IDENTITY, noise=matrix))


@pytest.mark.parametrize(
    ("params", "said"),
    [
        (LinearGaussianParams(transition=((1.0,), (1.0,)), noise=IDENTITY), "transition = .*2 rows of 2 numbers"),
        (LinearGaussianParams(transition=(), noise=()), "transition = .*rows"),
        (LinearGaussianParams(transition=IDENTITY, noise=((1.0,),)), "noise = .*2 rows of 2 numbers"),
        (LinearGaussianParams(transition=IDENTITY, noise=((1.0, 0.1), (0.0, 1.0))), "noise = .*symmetric"),
        (
            LinearGaussianParams(transition=IDENTITY, noise=((float("nan"), 0.0), (0.0, 1.0))),
            r"noise\.0\.0 = nan",
        ),
        (LinearGaussianParams(transition=IDENTITY, noise=IDENTITY, input=((1.0,),)), "input = .*2 rows of 1 numbers"),
    ],
)
def test_matrices_that_do_not_fit_are_named(params: LinearGaussianParams, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        LinearGaussian(params)


def test_a_control_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"control of shape \(2,\): the input matrix takes \(1,\)"):
        LinearGaussian(CONSTANT_VELOCITY).expected(np.zeros((2, 1)), np.zeros(2))
