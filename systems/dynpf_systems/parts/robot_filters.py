"""Filters for the robot of the rearrangement task: a point that moves as commanded, measured with Gaussian noise."""

import math
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from dynpf_runtime.node import State

from dynpf.filters import kalman
from dynpf.filters.cloud import Cloud, uniform_cloud
from dynpf.filters.estimate import mean_and_covariance
from dynpf.filters.extended import ExtendedKalman, ExtendedKalmanParams
from dynpf.filters.particle import ParticleFilter
from dynpf.filters.proposal import Auxiliary, LocalLinearization, Optimal, Prior
from dynpf.filters.resampling import Indices, Systematic, systematic
from dynpf.filters.unscented import UnscentedKalman, UnscentedKalmanParams
from dynpf.measurement.linear import LinearMeasurement, Observation
from dynpf.motion.linear import LinearGaussian, LinearGaussianParams
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats
from dynpf_systems.parts.config import RearrangementConfig

__all__ = ["Belief", "RobotFilter", "Seen", "fused", "robot_filter"]


_Proposal = Optimal | Prior | Auxiliary | LocalLinearization

SHOWN = 200  # particles at most in a published cloud
FEWEST = 5.0  # least effective sample size for which the covariance is corrected


class Seen(NamedTuple):
    """A reading of the robot's position, (2,), and the variance of each coordinate."""

    position: FloatArray
    variance: float


class Belief(NamedTuple):
    """Mean (2,) and covariance (2, 2) of the robot's position; ``cloud`` are the particles of a particle filter.

    ``families`` (N,) are the particles' ancestors at the last resampling.
    """

    mean: FloatArray
    covariance: FloatArray
    n_eff: float = 0.0
    cloud: Cloud | None = None
    families: Indices | None = None

    def freeze(self) -> State:
        """Return the belief as plain state."""
        return {**self._asdict(), "cloud": None if self.cloud is None else list(self.cloud)}

    @classmethod
    def thaw(cls, state: State) -> "Belief":
        """Return the belief from the state that freeze returned."""
        cloud = None if state["cloud"] is None else Cloud(*state["cloud"])
        return cls(state["mean"].copy(), state["covariance"].copy(), state["n_eff"], cloud, state["families"])

    @property
    def variance(self) -> float:
        """The variance of a coordinate, as the mean of both."""
        return float(self.covariance[0, 0] + self.covariance[1, 1]) / 2.0

    @property
    def shown(self) -> Floats:
        """Particles sampled by weight, (2, M), or the mean and points around it with the belief's covariance."""
        if self.cloud is not None:
            weights = self.cloud.weights
            return self.cloud.particles[:, systematic(weights, 0.5, min(SHOWN, weights.size))]
        offsets = kalman.symmetric_offsets(self.covariance, 2.0)
        return np.concatenate([self.mean[:, None], self.mean[:, None] + offsets], axis=1)


class RobotFilter(Protocol):
    """A filter without state: the belief is passed in and returned."""

    def start(self, seen: Seen, stream: Stream) -> Belief:
        """Return the initial belief from a first reading (PARTS table 3.1, step 1)."""

    def step(self, belief: Belief, shift: FloatArray, variance: float, seen: Seen | None, stream: Stream) -> Belief:
        """Return the belief after a motion by ``shift``, (2,), with process noise ``variance``, and a reading."""

    def rehearse(self, seen: Seen, variance: float, stream: Stream) -> None:
        """Execute every code path of the other methods once, with beliefs that are thrown away."""


def fused(seen: list[Seen]) -> Seen | None:
    """Return the readings fused into one, weighted by inverse variance; None without any."""
    if len(seen) < 2:
        return seen[0] if seen else None
    information = [1.0 / sighting.variance for sighting in seen]
    total = math.fsum(information)
    position = (
        np.add.reduce([sighting.position * share for sighting, share in zip(seen, information, strict=True)]) / total
    )
    return Seen(position, 1.0 / total)


def robot_filter(config: RearrangementConfig) -> RobotFilter:
    """Return the filter that a scenario names."""
    match config.filter:
        case "extended_kalman" | "unscented_kalman":
            return _GaussianRobot(config.filter)
        case name:
            return _ParticleRobot(_PROPOSALS[name], config.n, config.resampling_threshold)


class _ParticleRobot:
    """Sequential importance resampling with a proposal by name."""

    def __init__(self, proposal: _Proposal, n: int, threshold: float) -> None:
        self._proposal, self._n, self._threshold = proposal, n, threshold

    def start(self, seen: Seen, stream: Stream) -> Belief:
        """See RobotFilter."""
        drawn = seen.position[:, None] + math.sqrt(seen.variance) * stream.normals(2, self._n).astype(np.float64)
        cloud = uniform_cloud(drawn)
        mean, covariance = mean_and_covariance(cloud.particles, cloud.weights)
        families = np.arange(self._n, dtype=np.int32)
        return Belief(mean, covariance * _allowance(float(self._n)), cloud.n_eff, cloud, families)

    def step(self, belief: Belief, shift: FloatArray, variance: float, seen: Seen | None, stream: Stream) -> Belief:
        """See RobotFilter."""
        assert belief.cloud is not None
        assert belief.families is not None
        readings = [] if seen is None else [Observation(seen.position)]
        particles = _particle_filter(self._proposal, self._threshold, variance, 1.0 if seen is None else seen.variance)
        cloud, report = particles.update(belief.cloud, shift, readings, stream)
        mean, covariance = report.estimate
        copies_of, families = belief.families, belief.families
        if report.survivors is not None:
            copies_of, families = families[report.survivors], report.survivors
        widened = covariance * _allowance(_independent(cloud, copies_of))
        return Belief(mean, widened, report.n_eff, cloud, families)

    def rehearse(self, seen: Seen, variance: float, stream: Stream) -> None:
        """See RobotFilter."""
        always = _ParticleRobot(self._proposal, self._n, threshold=1.0)  # resamples at every step
        _rehearse(always, seen, variance, stream)


def _independent(cloud: Cloud, families: Indices) -> float:
    """Return the number of independent draws with the cloud's accuracy of the mean: its variance over that of its mean.

    The variance of the mean is the sum over families of squared sums of weighted deviations (Lee and Whiteley, 2018,
    with the ancestors of the last resampling), so that copies not yet separated by the motion count as a single draw.
    """
    deviation = cloud.particles - np.sum(cloud.weights * cloud.particles, axis=1, keepdims=True)
    weighted = cloud.weights * deviation
    of_mean = math.fsum(float(np.sum(np.square(np.bincount(families, row)))) for row in weighted)
    of_one = float(np.sum(weighted * deviation))
    return of_one / of_mean if of_mean > 0.0 else math.inf


def _allowance(draws: float) -> float:
    """Return the factor that widens the covariance of ``draws`` samples of the posterior to account for their number.

    The squared Mahalanobis distance of another sample to the mean and covariance of n draws is Hotelling's T^2 (1931),
    whose mean is D (n + 1) (n - 1) / (n (n - D - 2)); with this factor it is D.
    """
    n = max(draws, FEWEST)
    return (n + 1.0) * (n - 1.0) / (n * (n - 4.0)) if math.isfinite(n) else 1.0


class _GaussianRobot:
    """An extended or unscented Kalman filter; with these linear models both equal the Kalman filter."""

    def __init__(self, name: str) -> None:
        self._extended = name == "extended_kalman"

    def start(self, seen: Seen, stream: Stream) -> Belief:  # noqa: ARG002
        """See RobotFilter."""
        return Belief(seen.position, seen.variance * np.eye(2))

    def step(
        self,
        belief: Belief,
        shift: FloatArray,
        variance: float,
        seen: Seen | None,
        stream: Stream,  # noqa: ARG002
    ) -> Belief:
        """See RobotFilter."""
        motion, measurement = _models(variance, 1.0 if seen is None else seen.variance)
        models: dict[type, Any] = {Observation: measurement}
        gaussian = kalman.Gaussian(belief.mean, belief.covariance)
        named: ExtendedKalman[Any] | UnscentedKalman[Any]
        if self._extended:
            named = ExtendedKalman(motion, models, ExtendedKalmanParams(angles=()))
        else:
            named = UnscentedKalman(motion, models, UnscentedKalmanParams(angles=()))
        gaussian = named.predict(gaussian, shift)
        if seen is not None:
            gaussian, _ = named.update(gaussian, Observation(seen.position))
        return Belief(*gaussian)

    def rehearse(self, seen: Seen, variance: float, stream: Stream) -> None:
        """See RobotFilter."""
        _rehearse(self, seen, variance, stream)


def _rehearse(robot: RobotFilter, seen: Seen, variance: float, stream: Stream) -> None:
    belief = robot.start(seen, stream.part("start"))
    for number, sight in enumerate((None, seen, seen)):
        belief = robot.step(belief, np.zeros(2), variance, sight, stream.part(number))


@lru_cache(maxsize=64)
def _particle_filter(
    proposal: _Proposal, threshold: float, process: float, measured: float
) -> ParticleFilter[tuple[FloatArray, FloatArray]]:
    motion, measurement = _models(process, measured)
    return ParticleFilter(
        motion,
        {Observation: measurement},
        proposal=proposal,
        resampling=Systematic(threshold=threshold),
        estimate=mean_and_covariance,
    )


@lru_cache(maxsize=64)
def _models(process: float, measured: float) -> tuple[LinearGaussian, LinearMeasurement]:
    """Return the models x' = x + shift + noise and z = x + noise with these variances (PARTS eq. 3.1 and 3.4)."""
    identity = ((1.0, 0.0), (0.0, 1.0))
    noise = ((process, 0.0), (0.0, process))
    motion = LinearGaussian(LinearGaussianParams(transition=identity, noise=noise, input=identity))
    return motion, LinearMeasurement(np.eye(2), measured * np.eye(2))


_PROPOSALS: dict[str, _Proposal] = {
    "optimal": Optimal(),
    "prior": Prior(),
    "auxiliary": Auxiliary(),
    "local_linearization": LocalLinearization(),
}
