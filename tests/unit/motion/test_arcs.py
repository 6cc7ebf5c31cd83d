"""The arc model: its path, its independence of the step's length, and the calibration on top of it."""

import numpy as np
import pytest

from dynpf.motion import Arcs, ArcsParams, CalibratedArcs, CalibrationParams, Twist
from dynpf.motion.calibration import BEARING_BIAS, LAG, RANGE_SCALE, TURN_SCALE, WAY_SCALE
from dynpf.rng import Stream
from dynpf.types import Floats

NOISELESS = ArcsParams(
    along_variance_per_m=0.0, across_variance_per_m=0.0, turn_variance_per_rad=0.0, turn_variance_per_m=0.0
)


def stream(step: int = 0) -> Stream:
    return Stream.of(1, "test", step, "motion")


def test_one_metre_and_one_radian_a_second_trace_a_circle_of_radius_one() -> None:
    model = Arcs(NOISELESS)
    pose = np.zeros((3, 1), dtype=np.float32)
    for step in range(1, 201):
        pose = model.propagate(pose, Twist(1.0, 1.0, 0.1), stream(step))
        # A rounding of 2**-24 or so at every step.
        assert np.hypot(pose[0, 0], pose[1, 0] - 1.0) == pytest.approx(1.0, abs=200 * 2.0**-23)
        assert np.cos(pose[2, 0] - 0.1 * step) == pytest.approx(1.0, abs=1e-9)


def test_a_full_turn_in_one_step_closes_the_circle() -> None:
    start = np.array([[1.0], [2.0], [0.5]])
    circle = Twist(1.0, 1.0, 2.0 * np.pi)
    assert Arcs(NOISELESS).expected(start, circle)[:, 0] == pytest.approx([1.0, 2.0, 0.5 + 2.0 * np.pi], abs=1e-14)
    assert Arcs(NOISELESS).propagate(start, circle, stream())[:, 0] == pytest.approx([1.0, 2.0, 0.5], abs=1e-6)


def test_headings_stay_within_a_turn_however_long_the_robot_spins() -> None:
    pose: Floats = np.zeros((3, 1))
    for step in range(1000):
        pose = Arcs(NOISELESS).propagate(pose, Twist(0.0, 3.0, 1.0), stream(step))
        assert abs(pose[2, 0]) < np.pi + 1e-6
    assert np.cos(pose[2, 0] - 3000.0) == pytest.approx(1.0, abs=1e-7)


def test_the_length_of_the_step_changes_neither_path_nor_variance() -> None:
    params = ArcsParams(turn_variance_per_rad=0.0, turn_variance_per_m=0.0, along_variance_per_m=0.01)
    start: Floats = np.zeros((3, 40_000))
    once = Arcs(params).propagate(start, Twist(1.0, 0.0, 1.0), stream())
    often = start
    for step in range(1, 11):
        often = Arcs(params).propagate(often, Twist(1.0, 0.0, 0.1), stream(step))
    # Five standard errors: 0.1 / 200 of the mean's difference, 0.7 % of each variance.
    assert once[:2].mean(axis=1) == pytest.approx(often[:2].mean(axis=1), abs=3.5e-3)
    assert once[:2].var(axis=1) == pytest.approx(often[:2].var(axis=1), rel=0.05)


def test_each_particle_turns_by_its_own_scale() -> None:
    model = CalibratedArcs(NOISELESS, CalibrationParams(turn_scale_walk=0.0))
    particles = model.particles(np.zeros((3, 3)), stream())
    particles[TURN_SCALE] = 0.5, 1.0, 2.0
    moved = model.propagate(particles, Twist(0.0, 0.4, 0.5), stream(1))
    assert moved[2] == pytest.approx([0.1, 0.2, 0.4])
    assert np.array_equal(moved[TURN_SCALE], particles[TURN_SCALE])


def test_turn_scales_start_around_one() -> None:
    poses = np.arange(60_000.0).reshape(3, 20_000) / 8.0  # nearer to zero than where float64 is kept
    particles = CalibratedArcs(ArcsParams(), CalibrationParams(turn_scale_sigma=0.2)).particles(poses, stream())
    assert particles.dtype == np.float32
    assert np.array_equal(particles[:3], poses)
    assert particles[TURN_SCALE].mean() == pytest.approx(1.0, abs=0.2 * 5 / 141)
    assert particles[TURN_SCALE].std() == pytest.approx(0.2, rel=5 / 200)


def test_a_small_turn_scale_does_not_mean_less_noise() -> None:
    model = CalibratedArcs(ArcsParams(), CalibrationParams())
    particles = model.particles(np.zeros((3, 100_000)), stream())
    particles[TURN_SCALE, ::2] = 0.5
    particles[TURN_SCALE, 1::2] = 1.5
    moved = model.propagate(particles, Twist(0.0, 0.5, 0.2), stream())
    assert moved[2, ::2].var() == pytest.approx(moved[2, 1::2].var(), rel=0.04)
    assert moved[2, ::2].var() == pytest.approx(ArcsParams().turn_variance_per_rad * 0.1, rel=0.04)


def test_calibration_walks_by_the_time_that_the_robot_moves() -> None:
    model = CalibratedArcs(ArcsParams(), CalibrationParams(turn_scale_sigma=0.0, turn_scale_walk=0.1))
    particles = model.particles(np.zeros((3, 50_000)), stream())
    assert np.all(particles[TURN_SCALE] == 1.0)
    assert np.array_equal(model.propagate(particles, Twist(0.0, 0.0, 4.0), stream(1)), particles)
    moved = model.propagate(particles, Twist(0.1, 0.0, 4.0), stream(1))
    assert moved[TURN_SCALE].std() == pytest.approx(0.2, rel=0.02)


def test_each_particle_goes_its_own_way_scale() -> None:
    model = CalibratedArcs(NOISELESS, CalibrationParams(turn_scale_walk=0.0))
    particles = model.particles(np.zeros((3, 2)), stream())
    particles[WAY_SCALE] = 0.5, 2.0
    assert model.propagate(particles, Twist(1.0, 0.0, 0.5), stream(1))[0] == pytest.approx([0.25, 1.0])


def test_a_sensor_s_calibration_is_drawn_and_walks_as_it_is_told() -> None:
    sigmas = CalibrationParams(bearing_bias_sigma=0.02, range_scale_sigma=0.05, range_scale_walk=0.01)
    model = CalibratedArcs(NOISELESS, sigmas)
    particles = model.particles(np.zeros((3, 20_000)), stream())
    assert particles[BEARING_BIAS].std() == pytest.approx(0.02, rel=0.03)
    assert particles[BEARING_BIAS].mean() == pytest.approx(0.0, abs=0.02 * 5 / 141)
    assert particles[RANGE_SCALE].mean() == pytest.approx(1.0, abs=0.05 * 5 / 141)
    moved = model.propagate(particles, Twist(0.1, 0.0, 4.0), stream(1))
    assert np.array_equal(moved[BEARING_BIAS], particles[BEARING_BIAS])
    assert (moved[RANGE_SCALE] - particles[RANGE_SCALE]).std() == pytest.approx(0.02, rel=0.03)


def test_a_particle_with_a_lag_goes_on_as_before_for_so_long() -> None:
    model = CalibratedArcs(NOISELESS, CalibrationParams(turn_scale_sigma=0.0, turn_scale_walk=0.0, lag_sigma=0.1))
    late = model.particles(np.zeros((3, 3)), stream())
    late[LAG] = -0.1, 0.0, 0.2
    late = model.propagate(late, Twist(1.0, 0.0, 1.0), stream(1))
    assert late[0] == pytest.approx([1.1, 1.0, 0.8])  # it stood before
    late = model.propagate(late, Twist(1.0, 0.0, 1.0), stream(2))
    assert late[0] == pytest.approx([2.1, 2.0, 1.8])  # nothing has changed
    late = model.propagate(late, Twist(0.0, 0.0, 1.0), stream(3))
    assert late[0] == pytest.approx([2.0, 2.0, 2.0])  # it stands, all late and early moves made up for
