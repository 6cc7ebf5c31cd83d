"""The filters as the estimator drives them: what they believe goes in and comes out, and can be kept as plain state."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from dynpf.filters import kalman
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import PoseEstimate, modes, pose_estimate, weighted_covariance
from dynpf.filters.extended import ExtendedKalman
from dynpf.filters.kalman import Gaussian
from dynpf.filters.models import Outcome
from dynpf.filters.particle import ParticleFilter, Report
from dynpf.filters.resampling import systematic
from dynpf.filters.unscented import UnscentedKalman
from dynpf.portable import log_determinant
from dynpf.rng import Stream
from dynpf.se2 import Floats

__all__ = ["CloudFilter", "Found", "GaussianLocalizer", "Localizer", "ParticleLocalizer"]


MOST_IN_MODES = 10_000
"""Particles among which modes are looked for."""


class Found(NamedTuple):
    """What is believed of the pose, from how many particles in effect, and what became of each reading.

    ``log_evidence`` is that of the ``readings`` that were used, each of a batch by itself; NaN if none was.
    """

    estimate: PoseEstimate
    n_eff: float
    share: float  # n_eff of all there are
    outcomes: Sequence[Outcome] = ()
    log_evidence: float = math.nan
    readings: int = 0
    jump: float = 0.0  # probability that the robot has been set down elsewhere
    unfit: int = 0  # searches in a row that found it nowhere


class Localizer(Protocol):
    """A filter over the pose of a robot; ``belief`` is whatever it started with or gave back last."""

    def start(self, poses: Floats, stream: Stream) -> Any:
        """Return the belief that poses (3, N) stand for."""

    def predict(self, belief: Any, control: Any, stream: Stream) -> Any:
        """Return the belief after a control."""

    def update(self, belief: Any, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Any, Found]:
        """Return the belief after a control (None: none) and the readings at its end, and what was found."""

    def find(self, belief: Any) -> Found:
        """Return what is believed now."""

    def modes(self, belief: Any) -> tuple[float, ...] | None:
        """Return how much of the belief each of its modes holds, the greatest first; None where there is but one."""

    def shown(self, belief: Any, most: int) -> Floats:
        """Return poses (3, M), M <= most, that stand for the belief in a picture."""

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        """Do once, to a belief that is thrown away, all that the other methods may ever do."""

    def freeze(self, belief: Any) -> Mapping[str, Any]:
        """Return the belief as plain state."""

    def thaw(self, state: Mapping[str, Any]) -> Any:
        """Return the belief that freeze was given."""


class CloudFilter(Protocol):
    """What the estimator asks of a filter of particles, the library's or a user's; see ParticleFilter."""

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """Return the cloud at the given poses (3, N)."""

    def predict(self, cloud: Cloud, control: Any, stream: Stream) -> Cloud:
        """Return the cloud after a control."""

    def update(self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Cloud, Any]:
        """Return the cloud after a control (None: none) and the readings at its end, and a Report of it."""


class ParticleLocalizer:
    """A filter of particles: the library's, or a user's that has its methods."""

    def __init__(self, cloud_filter: CloudFilter | ParticleFilter[PoseEstimate]) -> None:
        self.filter = cloud_filter

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        return self.filter.start(poses, stream)

    def predict(self, belief: Cloud, control: Any, stream: Stream) -> Cloud:
        return self.filter.predict(belief, control, stream)

    def update(self, belief: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Cloud, Found]:
        cloud, report = self.filter.update(belief, control, readings, stream)
        share = report.n_eff / belief.weights.size
        evidence = report.log_evidence if report.readings else math.nan
        found = Found(report.estimate, report.n_eff, share, report.outcomes, evidence, report.readings)
        doubt = report.doubt if isinstance(report, Report) else None
        return cloud, found if doubt is None else found._replace(jump=doubt.jumped, unfit=doubt.unfit)

    def find(self, belief: Cloud) -> Found:
        share = belief.n_eff / belief.weights.size
        return Found(pose_estimate(belief.particles, belief.weights), belief.n_eff, share)

    def modes(self, belief: Cloud) -> tuple[float, ...]:
        every = math.ceil(belief.weights.size / MOST_IN_MODES)
        weights = np.ascontiguousarray(belief.weights[::every])
        return tuple(mode.mass for mode in modes(belief.particles[:3, ::every], weights))

    def shown(self, belief: Cloud, most: int) -> Floats:
        # Chosen by weight, not by place, so that what is looked at is the posterior.
        return belief.particles[:3, systematic(belief.weights, 0.5, min(most, belief.weights.size))]

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        cloud, _ = _rehearsed(self, poses, control, readings, stream)
        if isinstance(self.filter, ParticleFilter):
            rescue, doubt = self.filter.rescue, None
            if rescue is not None:
                doubt = rescue.doubt(cloud, 0.0, 1, readings)._replace(share=0.5)
            stream = stream.part("resample")
            survivors = self.filter.resample(cloud, doubt, stream)
            particles = self.filter.spread(survivors, cloud, stream)
            self.filter.renew(particles, survivors.missing, doubt, readings, stream)

    def freeze(self, belief: Cloud) -> Mapping[str, Any]:
        return belief._asdict()

    def thaw(self, state: Mapping[str, Any]) -> Cloud:
        arrays = {name: np.array(state[name]) for name in ("particles", "weights", "log_weights")}
        return Cloud(**arrays, n_eff=state["n_eff"], moved=state["moved"], memory=tuple(state["memory"]))


class GaussianLocalizer:
    """A Kalman filter; several readings of one instant are taken in one after the other."""

    def __init__(self, kalman_filter: ExtendedKalman[Any] | UnscentedKalman[Any]) -> None:
        self.filter = kalman_filter

    def start(self, poses: Floats, stream: Stream) -> Gaussian:
        """Return mean and covariance of the poses, and of what the motion model draws besides."""
        states = np.asarray(self.filter.motion.particles(poses, stream), dtype=np.float64)
        pose = pose_estimate(states, np.full(states.shape[1], 1.0 / states.shape[1]))
        mean = np.concatenate([pose.mean, states[3:].mean(axis=1)])
        deviation = kalman.wrap_rows(states - mean[:, None], (2,))
        count = states.shape[1]
        return Gaussian(mean, weighted_covariance(deviation, np.ones(count)) / count)

    def predict(self, belief: Gaussian, control: Any, stream: Stream) -> Gaussian:  # noqa: ARG002
        return self.filter.predict(belief, control)

    def update(self, belief: Gaussian, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Gaussian, Found]:
        if control is not None:
            belief = self.predict(belief, control, stream)
        outcomes, evidence, numbers = [], 0.0, 0
        for reading in readings:
            belief, innovation = self.filter.update(belief, reading)
            outcomes.append(Outcome.USED if innovation.used else Outcome.REFUSED)
            if innovation.used:
                evidence -= 0.5 * (innovation.nis + log_determinant(2.0 * math.pi * innovation.covariance))
                numbers += innovation.vector.size
        found = self.find(belief)._replace(outcomes=outcomes, readings=numbers)
        return belief, found._replace(log_evidence=float(evidence)) if numbers else found

    def find(self, belief: Gaussian) -> Found:
        return Found(PoseEstimate(belief.mean[:3], belief.covariance[:3, :3]), 0.0, 1.0)

    def modes(self, belief: Gaussian) -> None:  # noqa: ARG002
        return None

    def shown(self, belief: Gaussian, most: int) -> Floats:
        """Return the mean, and points about it that have the belief's covariance."""
        offsets = kalman.symmetric_offsets(belief.covariance, float(belief.mean.size))
        states = np.concatenate([belief.mean[:, None], belief.mean[:, None] + offsets], axis=1)
        return states[:3, :: math.ceil(states.shape[1] / most)]

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        _rehearsed(self, poses, control, readings, stream)

    def freeze(self, belief: Gaussian) -> Mapping[str, Any]:
        return belief._asdict()

    def thaw(self, state: Mapping[str, Any]) -> Gaussian:
        return Gaussian(np.array(state["mean"]), np.array(state["covariance"]))


def _rehearsed(
    localizer: Localizer, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream
) -> tuple[Any, Found]:
    belief = localizer.start(poses, stream.part("start"))
    belief = localizer.predict(belief, control, stream.part("predict"))
    localizer.update(belief, None, readings, stream.part("at rest"))
    belief, found = localizer.update(belief, control, readings, stream.part("update"))
    localizer.find(belief)
    localizer.modes(belief)
    localizer.shown(belief, 1)
    return belief, found
