"""The odometry model: a displacement taken apart, forward and backward, and the noise of its parts."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynpf.motion import Displacement, OdometryMotion, OdometryParams
from dynpf.motion.odometry import steps
from dynpf.rng import Stream
from dynpf.se2 import compose, wrap_angle

STREAM = Stream.of(1, "test", 0, "motion")
coordinate = st.floats(-2.0, 2.0)


@given(coordinate, coordinate, st.floats(-math.pi, math.pi))
def test_the_parts_put_together_are_the_displacement(dx: float, dy: float, turn: float) -> None:
    first, way, second = steps(Displacement(dx, dy, turn))
    assert (way * math.cos(first), way * math.sin(first)) == pytest.approx((dx, dy), abs=1e-12)
    assert math.remainder(first + second - turn, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert abs(first) <= math.pi / 2
    assert abs(second) <= math.pi


@given(coordinate, coordinate, st.floats(-math.pi, math.pi))
def test_the_expectation_is_the_composition_of_poses(dx: float, dy: float, turn: float) -> None:
    pose = np.array([0.5, -1.0, 2.0])
    expected = OdometryMotion(OdometryParams()).expected(pose[:, None], Displacement(dx, dy, turn))[:, 0]
    difference = expected - compose(pose, np.array([dx, dy, turn]))
    assert [*difference[:2], wrap_angle(difference[2])] == pytest.approx([0.0] * 3, abs=1e-12)


def heading_variance(displacement: Displacement, **alphas: float) -> float:
    given = {"alpha_1": 0.0, "alpha_2": 0.0, "alpha_3": 0.0, "alpha_4": 0.0} | alphas
    params = msgspec.convert(given, OdometryParams)
    return float(OdometryMotion(params).covariance(np.zeros((3, 1)), displacement)[2, 2, 0])


def test_backing_up_is_no_noisier_than_going_forward() -> None:
    ahead, back = Displacement(0.5, 0.05, 0.2), Displacement(-0.5, -0.05, 0.2)
    for alpha in ("alpha_1", "alpha_2"):
        assert heading_variance(back, **{alpha: 0.1}) == pytest.approx(heading_variance(ahead, **{alpha: 0.1}))
    assert heading_variance(Displacement(-0.5, 0.0, 0.0), alpha_1=0.1) == 0.0


def test_noise_that_grows_with_the_movement_is_the_same_in_any_number_of_steps() -> None:
    def variance(steps: int, growth: str) -> float:
        params = msgspec.convert({"kind": "odometry", "growth": growth}, OdometryParams)
        step = Displacement(0.6 / steps, 0.0, 0.3 / steps)
        return steps * float(OdometryMotion(params).covariance(np.zeros((3, 1)), step)[2, 2, 0])

    assert variance(12, "linear") == pytest.approx(variance(1, "linear"), rel=1e-9)
    assert variance(12, "squared") == pytest.approx(variance(1, "squared") / 12, rel=1e-9)  # the control


def test_turning_about_on_the_spot_is_as_noisy_as_half_a_turn_is() -> None:
    assert heading_variance(Displacement(0.0, 0.0, math.pi), alpha_1=0.1) == pytest.approx(0.1 * math.pi**2)


def test_no_first_rotation_is_read_into_a_translation_of_millimetres() -> None:
    turn = 0.3
    jitter, sideways = Displacement(0.0, 0.009, turn), Displacement(0.0, 0.011, turn)
    assert heading_variance(jitter, alpha_1=0.1) == pytest.approx(0.1 * turn**2)
    # The control: from a centimetre on the robot is taken to have turned before it went.
    assert heading_variance(sideways, alpha_1=0.1) == pytest.approx(
        0.1 * ((math.pi / 2) ** 2 + (math.pi / 2 - turn) ** 2)
    )


def test_samples_of_a_straight_way_have_closed_moments() -> None:
    """A mean shortened by the spread of directions: E[cos N(0, s^2)] = exp(-s^2 / 2)."""
    model = OdometryMotion(OdometryParams(alpha_1=0.0, alpha_2=0.16, alpha_3=0.01, alpha_4=0.0))
    moved = model.propagate(np.zeros((3, 200_000)), Displacement(1.0, 0.0, 0.0), STREAM).astype(np.float64)
    assert moved[0].mean() == pytest.approx(math.exp(-0.08), abs=5 * moved[0].std() / 447)
    assert moved[1].mean() == pytest.approx(0.0, abs=5 * moved[1].std() / 447)
    # Both rotations have the variance 0.16, so the alphas are factors of variances.
    assert moved[2].var() == pytest.approx(0.32, rel=5 * math.sqrt(2) / 447)
    assert np.mean(moved[0] ** 2 + moved[1] ** 2) == pytest.approx(1.01, abs=5 * 0.2 / 447)
