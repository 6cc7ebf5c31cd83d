"""The SIR filter against the exact posterior, and at its edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.filters.estimate import pose_estimate
from dynpf.filters.sir import Cloud, Outcome, Sir, SystematicParams, SystematicResampling
from dynpf.filters.start import KnownStart, around
from dynpf.maps import LandmarkMap
from dynpf.measurement import RangeBearing, RangeBearingParams, RangeBearingReading
from dynpf.motion import Arcs, ArcsParams, Twist
from dynpf.rng import generator
from dynpf.se2 import FloatArray


class Position:
    """A direct measurement of x with unit variance: the posterior is known in closed form."""

    def log_likelihood(self, particles: FloatArray, reading: float) -> FloatArray:
        return -0.5 * (particles[0] - reading) ** 2

    def plausible(self, particles: FloatArray, weights: FloatArray, reading: float) -> bool:  # noqa: ARG002
        return True


class Nowhere(Position):
    """A measurement that no particle explains."""

    def log_likelihood(self, particles: FloatArray, reading: float) -> FloatArray:  # noqa: ARG002
        return np.full(particles.shape[1], -np.inf)


def sir(model: Position, threshold: float = 0.5) -> Sir:
    resampling = SystematicResampling(SystematicParams(threshold=threshold))
    return Sir(Arcs(ArcsParams()), {float: model}, resampling)


def test_weights_and_survivors_have_the_moments_of_the_exact_posterior() -> None:
    rng = generator(1, "test", 0)
    start = around(KnownStart(x=1.0, sigma_position=2.0), 100_000, rng)
    cloud, outcome = sir(Position()).reweight(sir(Position()).start(start, rng), 3.0)
    assert outcome is Outcome.USED
    # Prior N(1, 4), reading 3 of unit variance: the posterior is N(2.6, 0.8).
    for posterior in (cloud, sir(Position(), threshold=1.0).resample(cloud, rng)):
        estimate = pose_estimate(posterior.particles, posterior.weights)
        assert estimate.mean[0] == pytest.approx(2.6, abs=0.02)
        assert estimate.covariance[0, 0] == pytest.approx(0.8, rel=0.03)
        assert posterior.weights.sum() == pytest.approx(1.0)


def test_resampling_waits_until_the_weights_are_uneven() -> None:
    rng = generator(2, "test", 0)
    filter_ = sir(Position())
    even = filter_.start(around(KnownStart(sigma_position=0.1), 500, rng), rng)
    assert filter_.resample(even, rng) is even
    uneven, _ = filter_.reweight(filter_.start(around(KnownStart(sigma_position=20.0), 500, rng), rng), 0.0)
    survivors = filter_.resample(uneven, rng)
    assert np.ptp(survivors.log_weights) == 0.0
    assert np.unique(survivors.particles[0]).size < 100


def test_when_no_particle_explains_a_reading_the_weights_stay_as_they_were() -> None:
    cloud = Cloud(np.zeros((3, 2)), np.log([0.3, 0.7]))
    after, outcome = sir(Nowhere()).reweight(cloud, 0.0)
    assert outcome is Outcome.IMPOSSIBLE
    assert after is cloud


def test_a_particle_of_weight_zero_stays_at_zero_and_never_survives() -> None:
    cloud = Cloud(np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]), np.array([-np.inf, 0.0]))
    after, _ = sir(Position()).reweight(cloud, 0.0)
    assert after.weights.tolist() == [0.0, 1.0]
    assert sir(Position(), threshold=1.0).resample(after, generator(3, "test", 0)).particles[0].tolist() == [1.0, 1.0]


def test_one_particle_is_a_filter_too_and_none_is_refused() -> None:
    rng = generator(4, "test", 0)
    filter_ = sir(Position(), threshold=1.0)
    cloud, _ = filter_.reweight(filter_.start(np.zeros((3, 1)), rng), 1e6)
    cloud = filter_.resample(filter_.predict(cloud, Twist(1.0, 0.1), 0.1, rng), rng)
    assert cloud.weights.tolist() == [1.0]
    assert np.isfinite(cloud.particles).all()
    assert not pose_estimate(cloud.particles, cloud.weights).covariance.any()
    with pytest.raises(ValueError, match="at least one pose"):
        filter_.start(np.zeros((3, 0)), rng)


@pytest.mark.parametrize("reading", [RangeBearingReading(1, np.nan, 0.0), RangeBearingReading(2, 1.0, 0.0)])
def test_a_reading_without_number_or_landmark_is_refused_and_changes_nothing(reading: RangeBearingReading) -> None:
    model = RangeBearing(RangeBearingParams(), LandmarkMap([(1, 1.0, 0.0)]))
    filter_ = Sir(Arcs(ArcsParams()), {RangeBearingReading: model}, SystematicResampling(SystematicParams()))
    cloud = filter_.start(np.zeros((3, 4)), generator(5, "test", 0))
    after, outcome = filter_.reweight(cloud, reading)
    assert outcome is Outcome.REFUSED
    assert after is cloud
    assert filter_.reweight(cloud, RangeBearingReading(1, 1.0, 0.0))[1] is Outcome.USED


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.floats(-50, 50), st.floats(-3, 3))
def test_the_estimate_turns_and_moves_with_the_particles(shift: float, turn: float) -> None:
    rng = generator(6, "test", 0)
    particles = rng.standard_normal((3, 64)) * np.array([[1.0], [2.0], [0.3]])
    weights = rng.random(64)
    weights /= weights.sum()
    here = pose_estimate(particles, weights)
    there = pose_estimate(particles + np.array([[shift], [0.0], [turn]]), weights)
    assert there.mean[0] - here.mean[0] == pytest.approx(shift, abs=1e-9)
    assert np.exp(1j * (there.mean[2] - here.mean[2])) == pytest.approx(np.exp(1j * turn))
    assert there.covariance == pytest.approx(here.covariance, abs=1e-9)


def test_the_covariance_is_the_weighted_one() -> None:
    rng = generator(7, "test", 0)
    particles, weights = rng.standard_normal((3, 40)), rng.random(40)
    particles[2] *= 0.1
    weights /= weights.sum()
    expected = np.cov(particles[:2], aweights=weights, ddof=0)
    assert pose_estimate(particles, weights).covariance[:2, :2] == pytest.approx(expected)
