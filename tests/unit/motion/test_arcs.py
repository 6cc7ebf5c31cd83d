"""The arc model: its path, the moments of its noise, and the calibration on top of it."""

import numpy as np
import pytest

from dynpf.motion import Arcs, ArcsParams, CalibratedArcs, CalibrationParams, Twist
from dynpf.motion.calibration import TURN_SCALE
from dynpf.rng import generator

NOISELESS = ArcsParams(
    along_variance_per_m=0.0, across_variance_per_m=0.0, turn_variance_per_rad=0.0, turn_variance_per_m=0.0
)


def test_one_metre_and_one_radian_a_second_trace_a_circle_of_radius_one() -> None:
    model = Arcs(NOISELESS)
    pose = np.zeros((3, 1))
    for step in range(1, 201):
        pose = model.propagate(pose, Twist(1.0, 1.0), 0.1, generator(1, "test", step))
        assert np.hypot(pose[0, 0], pose[1, 0] - 1.0) == pytest.approx(1.0, abs=1e-12)
    assert pose[2, 0] == pytest.approx(20.0)


def test_the_length_of_the_step_changes_neither_path_nor_variance() -> None:
    params = ArcsParams(turn_variance_per_rad=0.0, turn_variance_per_m=0.0, along_variance_per_m=0.01)
    start = np.zeros((3, 40_000))
    once = Arcs(params).propagate(start, Twist(1.0, 0.0), 1.0, generator(1, "test", 0))
    often = start
    for step in range(10):
        often = Arcs(params).propagate(often, Twist(1.0, 0.0), 0.1, generator(2, "test", step))
    assert once[:2].mean(axis=1) == pytest.approx(often[:2].mean(axis=1), abs=2e-3)
    assert once[:2].var(axis=1) == pytest.approx(often[:2].var(axis=1), rel=0.03)


def test_sampled_moments_are_the_analytic_ones() -> None:
    params = ArcsParams(
        along_variance_per_m=0.02, across_variance_per_m=0.005, turn_variance_per_rad=0.03, turn_variance_per_m=0.001
    )
    v, w, duration = 0.5, -0.8, 0.5
    moved = Arcs(params).propagate(np.zeros((3, 200_000)), Twist(v, w), duration, generator(3, "test", 0))
    turn_variance = 0.03 * 0.4 + 0.001 * 0.25
    assert moved[2].mean() == pytest.approx(-0.4, abs=5 * np.sqrt(turn_variance / 200_000))
    assert moved[2].var() == pytest.approx(turn_variance, rel=0.02)
    # In the frame of each particle's own chord, length and slip are what the parameters say.
    direction = 0.5 * moved[2]
    along = moved[0] * np.cos(direction) + moved[1] * np.sin(direction)
    across = -moved[0] * np.sin(direction) + moved[1] * np.cos(direction)
    length = along / np.sinc(direction / np.pi)
    assert length.mean() == pytest.approx(0.25, abs=1e-3)
    assert length.var() == pytest.approx(0.02 * 0.25, rel=0.02)
    assert across.mean() == pytest.approx(0.0, abs=5e-4)
    assert across.var() == pytest.approx(0.005 * 0.25, rel=0.02)


def test_a_robot_at_rest_stays_where_it_is() -> None:
    start = generator(4, "test", 0).standard_normal((3, 5))
    assert np.array_equal(Arcs(ArcsParams()).propagate(start, Twist(0.0, 0.0), 10.0, generator(4, "test", 1)), start)


def test_input_particles_are_left_alone() -> None:
    start = np.zeros((3, 4))
    Arcs(ArcsParams()).propagate(start, Twist(1.0, 1.0), 1.0, generator(5, "test", 0))
    assert not start.any()


def test_each_particle_turns_by_its_own_scale() -> None:
    still = CalibrationParams(turn_scale_walk=0.0)
    model = CalibratedArcs(NOISELESS, still)
    particles = model.particles(np.zeros((3, 3)), generator(6, "test", 0))
    particles[TURN_SCALE] = 0.5, 1.0, 2.0
    moved = model.propagate(particles, Twist(0.0, 0.4), 0.5, generator(6, "test", 1))
    assert moved[2] == pytest.approx([0.1, 0.2, 0.4])
    assert np.array_equal(moved[TURN_SCALE], particles[TURN_SCALE])


def test_a_small_turn_scale_does_not_mean_less_noise() -> None:
    model = CalibratedArcs(ArcsParams(), CalibrationParams())
    particles = np.zeros((4, 100_000))
    particles[TURN_SCALE, ::2] = 0.5
    particles[TURN_SCALE, 1::2] = 1.5
    moved = model.propagate(particles, Twist(0.0, 0.5), 0.2, generator(8, "test", 0))
    assert moved[2, ::2].var() == pytest.approx(moved[2, 1::2].var(), rel=0.03)
    assert moved[2, ::2].var() == pytest.approx(ArcsParams().turn_variance_per_rad * 0.1, rel=0.03)


def test_calibration_walks_only_while_the_robot_moves() -> None:
    params = CalibrationParams(turn_scale_sigma=0.0, turn_scale_walk=0.1)
    model = CalibratedArcs(ArcsParams(), params)
    particles = model.particles(np.zeros((3, 50_000)), generator(7, "test", 0))
    assert np.array_equal(model.propagate(particles, Twist(0.0, 0.0), 4.0, generator(7, "test", 1)), particles)
    moved = model.propagate(particles, Twist(0.1, 0.0), 4.0, generator(7, "test", 1))
    assert moved[TURN_SCALE].std() == pytest.approx(0.2, rel=0.02)
