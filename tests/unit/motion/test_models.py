"""What every motion model must hold to: its kernel's reference, its moments, its derivatives, and its columns apart."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.motion import (
    Arcs,
    ArcsParams,
    CalibratedArcs,
    CalibrationParams,
    CapsuleMotion,
    CapsuleStep,
    CapsuleStepParams,
    Displacement,
    GradientFlow,
    GradientFlowParams,
    LinearGaussian,
    LinearGaussianParams,
    OdometryMotion,
    OdometryParams,
    Twist,
    Velocity,
    VelocityParams,
)
from dynpf.reference import motion as twins
from dynpf.rng import Stream
from dynpf.se2 import FloatArray, Floats, wrap_angle

STREAM = Stream.of(1, "test", 3, "motion")


def swirl(states: Floats) -> Floats:
    """A smooth velocity field, of positions or of poses."""
    velocities = [np.sin(states[0]) - 0.5 * states[1], np.cos(states[1]) + states[0] ** 2]
    if len(states) == 3:
        velocities.append(0.3 * states[2] + states[0])
    return np.stack(velocities)


class Case(NamedTuple):
    model: Any
    control: Any
    rows: int = 3


WALKING = CalibrationParams(way_scale_walk=0.01, bearing_bias_walk=0.001, range_scale_walk=0.002)
CASES = {
    "arcs": Case(Arcs(ArcsParams()), Twist(0.7, -1.3, 0.8)),
    "arcs, straight back": Case(Arcs(ArcsParams()), Twist(-0.7, 0.0, 0.8)),
    "arcs, on the spot": Case(Arcs(ArcsParams()), Twist(0.0, 1.0, 0.8)),
    "calibrated arcs": Case(CalibratedArcs(ArcsParams(), WALKING), Twist(0.7, 1.3, 0.8), rows=7),
    "calibrated arcs with a lag": Case(
        CalibratedArcs(ArcsParams(), msgspec.structs.replace(WALKING, lag_sigma=0.1)), Twist(0.7, 1.3, 0.8), rows=10
    ),
    "velocity": Case(Velocity(VelocityParams()), Twist(0.7, -1.3, 0.8)),
    "odometry": Case(OdometryMotion(OdometryParams()), Displacement(0.4, -0.2, 0.5)),
    "odometry, backward": Case(OdometryMotion(OdometryParams()), Displacement(-0.4, 0.1, 0.5)),
    "odometry, on the spot": Case(OdometryMotion(OdometryParams()), Displacement(0.003, -0.004, 0.5)),
    "capsule step": Case(CapsuleStep(CapsuleStepParams()), CapsuleMotion(20.0, 0.7)),
    "linear": Case(
        LinearGaussian(
            LinearGaussianParams(
                transition=((1.0, 0.1), (0.2, 0.9)), noise=((0.04, 0.01), (0.01, 0.01)), input=((0.5,), (1.0,))
            )
        ),
        np.array([2.0]),
        rows=2,
    ),
    "gradient flow": Case(GradientFlow(GradientFlowParams(), swirl), 0.5, rows=2),
    "gradient flow of poses": Case(GradientFlow(GradientFlowParams(turn_variance=1e-4), swirl), 0.5),
}
every_model = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
every_kernel_of_poses = pytest.mark.parametrize(
    "case", [case for case in CASES.values() if case.rows == 3 and not isinstance(case.model, GradientFlow)]
)


def states_of(case: Case, count: int, dtype: type = np.float64) -> Floats:
    states = np.random.default_rng(7).uniform(-2.0, 2.0, (case.rows, count))
    if isinstance(case.model, CalibratedArcs):
        states[3:5] = 1.0 + 0.1 * states[3:5]
    return states.astype(dtype)


def quieter(case: Case, factor: float) -> Any:
    """Return the model with the standard deviations of its noise times a factor, where that is not tiny already."""
    model = case.model
    match model:
        case Arcs() | Velocity() | OdometryMotion():
            return type(model)(times(model.params, factor**2))
        case CalibratedArcs():
            return CalibratedArcs(times(model.params, factor**2), times(model.calibration, factor))
        case CapsuleStep():
            return CapsuleStep(times(model.params, factor))
    return model


def times(params: Any, factor: float) -> Any:
    return type(params)(**{name: factor * getattr(params, name) for name in numbers_of(params)})


def numbers_of(params: Any) -> list[str]:
    return [name for name in params.__struct_fields__ if isinstance(getattr(params, name), float)]


@every_model
def test_jacobian_is_the_derivative_of_the_expectation(case: Case) -> None:
    states, step = states_of(case, 20), 1e-6
    found = case.model.jacobian(states, case.control)
    for column in range(case.rows):
        shift = np.zeros((case.rows, 1))
        shift[column] = step
        ahead, behind = (case.model.expected(states + sign * shift, case.control) for sign in (1.0, -1.0))
        # Rounding of states of up to 20 over the step, and the step's square.
        assert found[:, column] == pytest.approx((ahead - behind) / (2.0 * step), abs=1e-8)


@every_model
def test_covariance_is_that_of_samples_where_the_noise_is_small(case: Case) -> None:
    model, count = quieter(case, 0.01), 100_000
    state = 0.3 * states_of(case, 1)
    covariance = model.covariance(state, case.control)[:, :, 0]
    moved = model.propagate(np.repeat(state, count, axis=1), case.control, STREAM)
    found = np.cov(moved.astype(np.float64))
    # Five standard errors of a Gaussian covariance; and rounding, where float32 is all the spread there is.
    variances = np.diag(covariance)
    allowed = 5.0 * np.sqrt((np.outer(variances, variances) + covariance**2) / count) + 1e-12
    assert np.all(np.abs(found - covariance) < allowed)
    assert np.any(np.abs(found - 1.1 * covariance) > allowed)


@every_model
def test_columns_are_moved_apart_and_in_any_batches(case: Case) -> None:
    particles = states_of(case, 40_000, np.float32)
    before = particles.copy()
    whole = case.model.propagate(particles, case.control, STREAM)
    expected = case.model.expected(particles, case.control)
    assert np.array_equal(particles, before)
    for start, stop in ((0, 1), (1, 300), (16_000, 17_000), (39_999, 40_000)):
        piece = particles[:, start:stop]
        assert np.array_equal(
            case.model.propagate(piece, case.control, STREAM.starting_at(start)), whole[:, start:stop]
        )
        assert np.array_equal(case.model.expected(piece, case.control), expected[:, start:stop])
    assert not np.array_equal(whole, case.model.propagate(particles, case.control, STREAM.starting_at(1)))


@every_model
def test_precision_and_shape_are_those_of_the_states(case: Case) -> None:
    for dtype in (np.float32, np.float64):
        states = states_of(case, 5, dtype)
        expected = case.model.expected(states, case.control)
        jacobian = case.model.jacobian(states, case.control)
        covariance = case.model.covariance(states, case.control)
        assert expected.shape == states.shape
        assert jacobian.shape == covariance.shape == (case.rows, case.rows, 5)
        assert {expected.dtype, jacobian.dtype, covariance.dtype} == {np.dtype(dtype)}


@every_kernel_of_poses
def test_without_noise_particles_go_where_expected_and_further_rows_pass_through(case: Case) -> None:
    particles = np.vstack((states_of(case, 1000), np.arange(1000.0)))
    moved = quieter(case, 0.0).propagate(particles, case.control, STREAM)
    assert moved.dtype == np.float32
    assert np.array_equal(moved[3], particles[3])
    assert np.abs(moved[2]).max() <= np.pi + 1e-6
    difference = moved - case.model.expected(particles, case.control)
    difference[2] = wrap_angle(difference[2])
    assert np.abs(difference).max() < 4e-6  # two units in the last place of coordinates of 20


@pytest.mark.parametrize(
    ("case", "at_rest"),
    [
        (CASES["arcs"], Twist(0.0, 0.0, 10.0)),
        (CASES["calibrated arcs"], Twist(0.0, 0.0, 10.0)),
        (CASES["velocity"], Twist(0.0, 0.0, 10.0)),
        (CASES["odometry"], Displacement(0.0, 0.0, 0.0)),
    ],
)
def test_a_robot_at_rest_gets_no_noise(case: Case, at_rest: Any) -> None:
    particles = states_of(case, 1000, np.float32)
    assert np.array_equal(case.model.propagate(particles, at_rest, STREAM), particles)
    assert not case.model.covariance(particles, at_rest).any()
    assert not np.array_equal(case.model.propagate(particles, case.control, STREAM), particles)


def told(number: float) -> bool:
    return number == 0.0 or abs(number) > 1e-4


@pytest.mark.parametrize(
    ("name", "rows", "numbers", "sigmas"),
    [
        ("follow_arcs", 3, 2, 3),
        ("follow_twist", 3, 2, 3),
        ("rotate_translate_rotate", 3, 3, 3),
        ("move_capsule", 3, 2, 2),
    ],
)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_kernels_do_as_their_references(name: str, rows: int, numbers: int, sigmas: int, data: st.DataObject) -> None:
    # The reference divides by the turn: below 1e-10 of a radian, but for none at all, that costs its digits.
    number = st.floats(-2.0, 2.0).filter(told)
    motion = data.draw(st.lists(number, min_size=numbers, max_size=numbers))
    deviations = data.draw(st.lists(st.floats(0.0, 0.5).filter(told), min_size=sigmas, max_size=sigmas))
    particles = np.random.default_rng(data.draw(st.integers(0, 99))).uniform(-4.0, 4.0, (rows, 37)).astype(np.float32)
    noise = STREAM.starting_at(data.draw(st.integers(0, 10_000))).normals(rows, 37)
    moved = np.empty_like(particles)
    getattr(kernels.motion, name)(*particles, noise, *motion, *deviations, *moved)
    twin: Callable[..., FloatArray] = getattr(twins, name)
    difference = moved - twin(particles.astype(np.float64), noise.astype(np.float64), motion, deviations)
    difference[2] = wrap_angle(difference[2])
    # Angles of up to 16 radians, rounded four times to 2**-21 at most, aim ways of up to 4 m.
    assert np.abs(difference).max() < 4 * 4 * 2.0**-21


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 9999), st.lists(st.floats(0.0, 0.5).filter(told), min_size=3, max_size=3))
def test_each_particle_s_own_arc_is_the_reference_s(seed: int, sigmas: list[float]) -> None:
    rows = np.random.default_rng(seed).uniform(-4.0, 4.0, (5, 37)).astype(np.float32)
    noise = STREAM.starting_at(seed).normals(3, 37)
    moved = np.empty_like(rows[:3])
    kernels.motion.follow_own_arcs(*rows, noise, *sigmas, *moved)
    wide = rows.astype(np.float64)
    difference = moved - twins.follow_own_arcs(wide[:3], wide[3], wide[4], noise.astype(np.float64), sigmas)
    difference[2] = wrap_angle(difference[2])
    # As above, twice as far and turned twice as much.
    assert np.abs(difference).max() < 4 * 8 * 2.0**-20


def moments(
    twin: Callable[..., FloatArray], pose: Sequence[float], motion: tuple[float, ...], sigmas: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean (3,) and covariance (3, 3) of a reference's end pose by Gauss and Hermite's quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    noise = np.stack(np.meshgrid(nodes, nodes, nodes)).reshape(3, -1)
    chances = np.prod(np.stack(np.meshgrid(weights, weights, weights)).reshape(3, -1), axis=0)
    chances /= chances.sum()
    ends = twin(np.repeat(np.array(pose)[:, None], chances.size, axis=1), noise, motion, sigmas)
    turned = sum(motion[:1] + motion[2:]) if twin is twins.rotate_translate_rotate else motion[1]
    ends[2] = pose[2] + turned + wrap_angle(ends[2] - pose[2] - turned)
    mean = ends @ chances
    errors = ends - mean[:, None]
    return mean, (errors * chances) @ errors.T


def standard_errors_off(moved: Floats, mean: FloatArray, covariance: FloatArray) -> float:
    """Return by how many standard errors the worst of the samples' means and covariances is off."""
    errors = moved.astype(np.float64) - mean[:, None]
    products = (errors[:, None] * errors[None, :]).reshape(9, -1)
    root = np.sqrt(moved.shape[1])
    return float(
        max(
            np.max(root * np.abs(errors.mean(axis=1)) / errors.std(axis=1)),
            np.max(root * np.abs(products.mean(axis=1) - covariance.ravel()) / products.std(axis=1)),
        )
    )


FIRST, SECOND = np.arctan2(0.8, 0.6), -0.4 - np.arctan2(0.8, 0.6)

# Each model, its control, and what its kernel should get: motion and variances by the formulas of its source.
SPREADS = {
    "arcs, large turn": (
        Arcs,
        ArcsParams(
            along_variance_per_m=0.02, across_variance_per_m=0.005, turn_variance_per_rad=0.01, turn_variance_per_m=0.02
        ),
        Twist(-1.0, -1.6, 1.25),
        (twins.follow_arcs, (-1.25, -2.0), (0.02 * 1.25, 0.01 * 2.0 + 0.02 * 1.25, 0.005 * 1.25)),
    ),
    "velocity, large turn": (
        Velocity,
        VelocityParams(alpha_1=0.02, alpha_2=0.01, alpha_3=0.015, alpha_4=0.03, alpha_5=0.02, alpha_6=0.015),
        Twist(1.0, -1.6, 1.25),
        (
            twins.follow_twist,
            (1.25, -2.0),
            (
                1.25**2 * (0.02 * 1.0 + 0.01 * 1.6),
                1.25**2 * (0.015 * 1.0 + 0.03 * 1.6),
                1.25**2 * (0.02 * 1.0 + 0.015 * 1.6),
            ),
        ),
    ),
    "odometry": (
        OdometryMotion,
        OdometryParams(alpha_1=0.05, alpha_2=0.02, alpha_3=0.02, alpha_4=0.03),
        Displacement(0.6, 0.8, -0.4),
        (
            twins.rotate_translate_rotate,
            (FIRST, 1.0, SECOND),
            (
                0.05 * FIRST**2 + 0.02 * 1.0,
                0.02 * 1.0 + 0.03 * (FIRST**2 + SECOND**2),
                0.05 * SECOND**2 + 0.02 * 1.0,
            ),
        ),
    ),
    "capsule step": (
        CapsuleStep,
        CapsuleStepParams(sigma=0.1, sigma_theta=0.2),
        CapsuleMotion(2.0, 0.7),
        (twins.move_capsule, (2.0, 0.7), (0.1**2, 0.2**2)),
    ),
}


@pytest.mark.parametrize("name", SPREADS)
def test_samples_have_the_analytic_mean_and_covariance(name: str) -> None:
    model, params, control, (twin, motion, variances) = SPREADS[name]
    pose = (0.3, -0.2, 0.5)
    mean, covariance = moments(twin, pose, motion, np.sqrt(variances))

    def off(tried: Any) -> float:
        start = np.repeat(np.array(pose, dtype=np.float32)[:, None], 200_000, axis=1)
        return standard_errors_off(model(tried).propagate(start, control, STREAM), mean, covariance)

    assert off(params) < 5.0
    # The control: every parameter tells, be it off by a quarter.
    for field in numbers_of(params):
        values = {name: getattr(params, name) for name in params.__struct_fields__}
        assert off(type(params)(**values | {field: 1.25 * values[field]})) > 5.0, field


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Arcs(ArcsParams(along_variance_per_m=-0.1)), r"ArcsParams\.along_variance_per_m = -0\.1: .*>= 0"),
        (lambda: Velocity(VelocityParams(alpha_3=-1.0)), r"VelocityParams\.alpha_3 = -1\.0: .*>= 0"),
        (lambda: OdometryMotion(OdometryParams(alpha_4=-1.0)), r"OdometryParams\.alpha_4 = -1\.0: .*>= 0"),
        (lambda: CapsuleStep(CapsuleStepParams(sigma=-0.1)), r"CapsuleStepParams\.sigma = -0\.1: .*>= 0"),
        (
            lambda: CalibratedArcs(ArcsParams(), CalibrationParams(turn_scale_walk=-1.0)),
            r"CalibrationParams\.turn_scale_walk = -1\.0: .*>= 0",
        ),
        (
            lambda: GradientFlow(GradientFlowParams(difference=0.0), swirl),
            r"GradientFlowParams\.difference = 0\.0: .*> 0",
        ),
    ],
)
def test_parameters_out_of_range_are_named_with_value_and_range(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()
