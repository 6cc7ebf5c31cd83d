"""The particle filter against the Kalman filter, which is exact for linear Gaussian models; and at its edges."""

import hashlib
from typing import Any

import numpy as np
import pytest

from dynpf.filters import kalman
from dynpf.filters.adaptation import Augmented, AugmentedParams, Kld, KldParams, Rescue
from dynpf.filters.cloud import uniform_cloud
from dynpf.filters.estimate import mean_and_covariance
from dynpf.filters.extended import ExtendedKalman
from dynpf.filters.models import Outcome
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.proposal import Auxiliary, LocalLinearization, Optimal, Prior
from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.resampling import Multinomial, Residual, Stratified, Systematic
from dynpf.filters.start import Box, KnownStart, UniformStart, pose_source, start_poses
from dynpf.filters.unscented import UnscentedKalman
from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.linear import LinearMeasurement, Observation
from dynpf.measurement.model import MeasurementModel
from dynpf.measurement.position import GaussianPosition, GaussianPositionParams, Position
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.measurement.scan import Scan
from dynpf.motion.arcs import Arcs, ArcsParams
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.motion.model import Displacement, Twist
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.rng import Stream
from dynpf.se2 import arc_displacement, compose

Models = dict[type, MeasurementModel[Any]]

STEPS, SEEDS, COUNT = 12, 30, 1500
F = np.array([[1.0, 0.5], [0.0, 0.95]])
Q = np.array([[0.05, 0.03], [0.03, 0.08]])
H = np.array([[1.0, 0.0]])
R = np.array([[0.2]])
PRIOR = kalman.Gaussian(np.array([0.3, -0.2]), np.array([[1.0, 0.3], [0.3, 0.5]]))
FREE = ()  # a control without inputs

FILTERS = {
    "bootstrap, systematic": {"proposal": Prior(), "resampling": Systematic()},
    "bootstrap, stratified": {"proposal": Prior(), "resampling": Stratified(when="always")},
    "bootstrap, residual": {"proposal": Prior(), "resampling": Residual(when="always")},
    "bootstrap, multinomial": {"proposal": Prior(), "resampling": Multinomial(when="always")},
    "auxiliary": {"proposal": Auxiliary()},
    "optimal": {"proposal": Optimal()},
    "local linearization": {"proposal": LocalLinearization()},
    "regularized": {"regularization": GaussianKernel(shrink=True, headings=False)},
}


def motion():
    return LinearGaussian(LinearGaussianParams(transition=tuple(map(tuple, F)), noise=tuple(map(tuple, Q))))


def observations():
    draw = Stream.of(7, "test", 0).normals(4, STEPS + 1).astype(float)
    state, found = PRIOR.mean + np.linalg.cholesky(PRIOR.covariance) @ draw[:2, 0], []
    for step in range(1, STEPS + 1):
        state = F @ state + np.linalg.cholesky(Q) @ draw[:2, step]
        found.append(H @ state + np.sqrt(R[0]) * draw[2, step])
    return found


def exact(measured):
    """Return the Kalman filter's last belief and the log-likelihood of all observations."""
    belief, log_likelihood = PRIOR, 0.0
    for z in measured:
        belief = kalman.predict(belief, F, Q)
        variance = (H @ belief.covariance @ H.T + R)[0, 0]
        log_likelihood -= 0.5 * ((z - H @ belief.mean)[0] ** 2 / variance + np.log(2 * np.pi * variance))
        belief = kalman.update(belief, z, H, R)
    return belief, log_likelihood


def estimates(parts, measured, noise=R):
    """Return the last mean of each seed, (SEEDS, 2), the mean last covariance, and each seed's log-evidence."""
    filter_ = ParticleFilter(
        motion(), {Observation: LinearMeasurement(H, noise)}, estimate=mean_and_covariance, **parts
    )
    means, covariances, evidence = [], [], []
    for seed in range(SEEDS):
        normals = Stream.of(seed, "test", 0, "prior").normals(2, COUNT).astype(float)
        states = PRIOR.mean[:, None] + np.linalg.cholesky(PRIOR.covariance) @ normals
        cloud = filter_.start(states, Stream.of(seed, "test", 0))
        total = 0.0
        for step, z in enumerate(measured, 1):
            cloud, report = filter_.update(cloud, FREE, [Observation(z)], Stream.of(seed, "test", step))
            total += report.log_evidence
        means.append(report.estimate[0])
        covariances.append(report.estimate[1])
        evidence.append(total)
    return np.array(means), np.mean(covariances, axis=0), np.array(evidence)


def off_by(values, truth):
    """Return how many standard errors the mean over seeds lies from the truth, each coordinate."""
    return np.abs(np.mean(values, axis=0) - truth) / (np.std(values, axis=0, ddof=1) / np.sqrt(SEEDS))


@pytest.mark.parametrize("parts", FILTERS.values(), ids=FILTERS)
def test_every_filter_agrees_with_kalman_within_monte_carlo_error(parts):
    measured = observations()
    belief, log_likelihood = exact(measured)
    means, covariance, evidence = estimates(parts, measured)
    # Student's t with 29 degrees of freedom exceeds 4.5 once in 10^4.
    assert np.all(off_by(means, belief.mean) < 4.5)
    # A filter's own error: a few times that of N independent draws from the posterior.
    assert np.all(np.std(means, axis=0) < 4.0 * np.sqrt(np.diag(belief.covariance) / COUNT))
    np.testing.assert_allclose(covariance, belief.covariance, rtol=0.06, atol=0.004)
    # The evidence itself is unbiased; its logarithm is low by half its variance.
    assert off_by(evidence, log_likelihood - 0.5 * np.var(evidence)) < 4.5


def test_control_a_filter_with_the_wrong_noise_does_not_agree():
    measured = observations()
    belief, log_likelihood = exact(measured)
    means, _, evidence = estimates(FILTERS["bootstrap, systematic"], measured, noise=4.0 * R)
    assert np.any(off_by(means, belief.mean) > 10.0)
    assert off_by(evidence, log_likelihood) > 10.0


def test_the_optimal_proposal_keeps_more_particles_alive():
    measured = observations()
    sharp: Models = {Observation: LinearMeasurement(H, 0.05 * R)}
    filters = [
        ParticleFilter(motion(), sharp, proposal=each, estimate=mean_and_covariance) for each in (Prior(), Optimal())
    ]
    states = PRIOR.mean[:, None] + Stream.of(1, "test", 0).normals(2, COUNT).astype(float)
    cloud = uniform_cloud(states)
    prior, optimal = (f.update(cloud, FREE, [Observation(measured[0])], Stream.of(2, "test", 1))[1] for f in filters)
    assert optimal.n_eff > 1.5 * prior.n_eff


GRID = OccupancyGrid.from_bools(Stream.of(1, "test", 0).uniforms(60, 80) < 0.02, 0.1)
SCAN = Scan(np.linspace(-2, 2, 20, dtype=np.float32), np.linspace(1, 4, 20, dtype=np.float32), 0.1, 8.0)


def laser_filter(**parts):
    models: Models = {
        Scan: LikelihoodField(LikelihoodFieldParams(tempering=0.3), GRID),
        Position: GaussianPosition(GaussianPositionParams(sigma=0.5)),
    }
    return ParticleFilter(OdometryMotion(OdometryParams()), models, **parts)


def laser_poses(count, spread=0.3):
    return np.array([[4.0], [3.0], [0.5]], dtype=np.float32) + np.float32(spread) * Stream.of(3, "test", 0).normals(
        3, count
    )


def digest(count, threads, seed=5):
    """Return the SHA-256 of every cloud and estimate of 50 updates."""
    filter_ = laser_filter(threads=threads)
    cloud = filter_.start(laser_poses(count), Stream.of(seed, "test", 0))
    found = hashlib.sha256()
    for step in range(1, 51):
        control = Displacement(0.05, 0.0, 0.1 if step % 2 else -0.1)
        cloud, report = filter_.update(cloud, control, [SCAN, Position(4.0, 3.0)], Stream.of(seed, "test", step))
        for array in (cloud.particles, cloud.weights, *report.estimate):
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


@pytest.mark.parametrize("count", [1_000, 10_000, 100_000])
def test_fifty_updates_give_the_same_bytes_on_one_two_and_four_threads(count):
    once = digest(count, 1)
    assert digest(count, 2) == once
    assert digest(count, 4) == once


def test_control_another_seed_gives_other_bytes():
    assert digest(1_000, 1) != digest(1_000, 1, seed=6)


def test_several_sensors_are_fused_in_one_update():
    filter_ = laser_filter(resampling=Systematic(threshold=0.0))
    cloud = filter_.start(laser_poses(500), Stream.of(1, "test", 0))
    both, report = filter_.update(cloud, None, [SCAN, Position(4.1, 2.9)], Stream.of(1, "test", 1))
    assert report.outcomes == [Outcome.USED, Outcome.USED]
    first, _ = filter_.update(cloud, None, [SCAN], Stream.of(1, "test", 1))
    second, _ = filter_.update(first, None, [Position(4.1, 2.9)], Stream.of(1, "test", 2))
    np.testing.assert_allclose(both.weights, second.weights, rtol=2e-4, atol=1e-9)


def test_readings_that_cannot_be_believed_leave_the_cloud_as_it_is():
    filter_ = laser_filter(resampling=Systematic(when="always"))
    cloud = filter_.start(laser_poses(100), Stream.of(1, "test", 0))
    nothing = [SCAN._replace(ranges=np.full(20, np.nan, dtype=np.float32)), Position(np.nan, 0.0)]
    after, report = filter_.update(cloud, None, nothing, Stream.of(1, "test", 1))
    assert report.outcomes == [Outcome.REFUSED, Outcome.REFUSED]
    assert (report.log_evidence, report.survivors) == (0.0, None)
    assert np.array_equal(after.particles, cloud.particles)
    assert np.array_equal(after.weights, cloud.weights)


class Nowhere:
    """A reading that no particle explains."""

    def admit(self, _particles, _weights, reading):
        return reading

    def log_likelihood(self, particles, _reading):
        return np.full(particles.shape[1], -np.inf, dtype=np.float32)


def test_when_no_particle_explains_a_reading_the_weights_stay_as_they_were():
    filter_ = ParticleFilter(OdometryMotion(OdometryParams()), {str: Nowhere()}, resampling=Systematic(threshold=0.1))
    cloud = filter_.start(laser_poses(10), Stream.of(1, "test", 0))
    after, report = filter_.update(cloud, Displacement(0.1, 0.0, 0.0), ["nowhere"], Stream.of(1, "test", 1))
    assert report.outcomes == [Outcome.IMPOSSIBLE]
    assert report.log_evidence == -np.inf
    assert np.array_equal(after.weights, cloud.weights)
    assert after.moved


def test_a_reading_that_no_model_takes_is_named():
    filter_ = laser_filter()
    cloud = filter_.start(laser_poses(10), Stream.of(1, "test", 0))
    with pytest.raises(TypeError, match="no measurement model takes a Observation; those given take: Position, Scan"):
        filter_.update(cloud, None, [Observation(np.zeros(1))], Stream.of(1, "test", 1))


@pytest.mark.parametrize("proposal", [Prior(), Auxiliary(), Optimal(), LocalLinearization()])
def test_one_particle_is_enough(proposal):
    models: Models = {Position: GaussianPosition(GaussianPositionParams(sigma=0.5))}
    filter_ = ParticleFilter(OdometryMotion(OdometryParams()), models, proposal=proposal)
    cloud = filter_.start(laser_poses(1), Stream.of(1, "test", 0))
    for step in range(1, 4):
        cloud, report = filter_.update(
            cloud, Displacement(0.1, 0.0, 0.1), [Position(4.0, 3.0)], Stream.of(1, "test", step)
        )
    assert cloud.weights.tolist() == [1.0]
    assert np.isfinite(report.estimate.mean).all()


def test_a_proposal_says_what_a_model_lacks():
    filter_ = laser_filter(proposal=Optimal())
    cloud = filter_.start(laser_poses(10), Stream.of(1, "test", 0))
    with pytest.raises(TypeError, match="Optimal needs a Gaussian model; LikelihoodField has no innovation"):
        filter_.update(cloud, Displacement(0.1, 0.0, 0.0), [SCAN], Stream.of(1, "test", 1))


def test_parameters_of_the_parts_are_checked():
    with pytest.raises(ValueError, match=r"Systematic\.threshold = 1\.5"):
        laser_filter(resampling=Systematic(threshold=1.5))
    with pytest.raises(ValueError, match="threads = 0"):
        laser_filter(threads=0)


MARKS = LandmarkMap([(1, 0.0, 0.0), (2, 6.0, 0.0), (3, 6.0, 4.0), (4, 1.0, 5.0)])
BOX = UniformStart(box=Box(x_min=0.0, x_max=6.0, y_min=0.0, y_max=5.0))


def seen_from(x, y, theta):
    """Return noise-free readings of all landmarks."""
    east, north = MARKS.positions - np.array([[x], [y]])
    return RangeBearingReadings(np.array(MARKS.ids), np.hypot(east, north), np.arctan2(north, east) - theta)


def landmark_filter(rescued=False, sizing=None, tempering=1.0):
    models: Models = {RangeBearingReadings: RangeBearing(RangeBearingParams(gate=None, tempering=tempering), MARKS)}
    rescue = Rescue(Augmented(AugmentedParams()), pose_source(BOX)) if rescued else None
    return ParticleFilter(Arcs(ArcsParams()), models, rescue=rescue, sizing=sizing)


def carried_off(filter_, updates=60):
    """Return the distance from the truth after a robot at rest was carried from one corner to the other."""
    cloud = filter_.start(start_poses(KnownStart(x=1.0, y=1.0), 2000, Stream.of(1, "test", 0)), Stream.of(2, "test", 0))
    for step in range(1, updates):
        place = (1.0, 1.0, 0.0) if step < 15 else (5.0, 3.5, 1.0)
        twist = Twist(0.05 if step % 2 else -0.05, 0.0, 1.0)
        cloud, report = filter_.update(cloud, twist, [seen_from(*place)], Stream.of(1, "test", step))
    return float(np.hypot(*(report.estimate.mean[:2] - np.array([5.0, 3.5]))))


def test_a_filter_with_a_rescue_finds_a_robot_that_was_carried_off():
    assert carried_off(landmark_filter(rescued=True)) < 0.3
    # Control: without one it stays where it was.
    assert carried_off(landmark_filter(rescued=False)) > 1.0


def test_kld_sizing_goes_on_with_fewer_particles_once_it_knows_the_place():
    filter_ = landmark_filter(sizing=Kld(KldParams(n_min=50, n_max=20_000)), tempering=0.1)
    cloud = filter_.start(start_poses(BOX, 10_000, Stream.of(1, "test", 0)), Stream.of(2, "test", 0))
    counts = []
    for step in range(1, 10):
        cloud, report = filter_.update(
            cloud, Twist(0.05, 0.0, 1.0), [seen_from(1.0 + 0.05 * step, 1.0, 0.0)], Stream.of(1, "test", step)
        )
        counts.append(cloud.weights.size)
    assert counts[-1] < 500
    assert np.hypot(*(report.estimate.mean[:2] - [1.45, 1.0])) < 0.1


@pytest.mark.parametrize("kalman_filter", [ExtendedKalman, UnscentedKalman])
def test_kalman_and_particle_filters_agree_where_models_are_nearly_linear(kalman_filter):
    arcs = Arcs(ArcsParams())
    # Without outliers and tempering all three solve the same problem.
    params = RangeBearingParams(gate=None, tempering=1.0, outlier_fraction=0.0, sigma_bearing=0.05)
    models: Models = {RangeBearingReadings: RangeBearing(params, MARKS)}
    particles, gaussian = ParticleFilter(arcs, models), kalman_filter(arcs, models)
    sigma = 0.1
    belief = kalman.Gaussian(np.array([2.0, 2.0, 0.3]), np.diag([sigma**2, sigma**2, 0.05**2]))
    start = KnownStart(x=2.0, y=2.0, theta=0.3, sigma_position=sigma, sigma_heading=0.05)
    cloud = particles.start(start_poses(start, 40_000, Stream.of(1, "test", 0)), Stream.of(2, "test", 0))
    truth = np.array([2.05, 1.95, 0.33])
    for step in range(1, 8):
        twist = Twist(0.3, 0.2, 1.0)
        truth = compose(truth, arc_displacement(twist.v * twist.duration, twist.w * twist.duration))
        reading = seen_from(*truth)
        belief = gaussian.predict(belief, twist)
        belief, _ = gaussian.update(belief, reading)
        cloud, report = particles.update(cloud, twist, [reading], Stream.of(1, "test", step))
    deviations = np.sqrt(np.diag(belief.covariance))
    # A tenth of a standard deviation: the curvature of range and bearing over the belief's width, and chance.
    assert np.all(np.abs(report.estimate.mean - belief.mean) < 0.1 * deviations)
    np.testing.assert_allclose(np.sqrt(np.diag(report.estimate.covariance)), deviations, rtol=0.1)
    # Control: the belief has moved by many times that.
    assert np.hypot(*(belief.mean[:2] - [2.0, 2.0])) > 10 * deviations[0]
