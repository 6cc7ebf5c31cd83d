"""The filters as the estimator uses them: the belief is passed in and returned, and can be kept as plain state."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from dynpf.filters import kalman
from dynpf.filters.cloud import Cloud, uniform_cloud
from dynpf.filters.estimate import PoseEstimate, modes, pose_estimate, weighted_covariance
from dynpf.filters.extended import ExtendedKalman
from dynpf.filters.kalman import Gaussian
from dynpf.filters.models import Outcome
from dynpf.filters.particle import ParticleFilter, Report
from dynpf.filters.relocation import Relocation
from dynpf.filters.resampling import systematic
from dynpf.filters.unscented import UnscentedKalman
from dynpf.portable import log_determinant
from dynpf.rng import Stream
from dynpf.types import Floats

__all__ = ["CloudFilter", "Found", "GaussianLocalizer", "Localizer", "ParticleLocalizer"]


NOT_EXPLAINED = -1e6
"""A log-evidence that no filter takes for usual."""

MOST_IN_MODES = 10_000
"""Number of particles in which modes are searched."""


class Found(NamedTuple):
    """The estimate of the pose, the effective sample size, and the outcome of each reading.

    ``log_evidence`` is that of the ``readings`` used, counted one by one in a batch; NaN if none was used.
    """

    estimate: PoseEstimate
    n_eff: float
    share: float  # n_eff of all there are
    outcomes: Sequence[Outcome] = ()
    log_evidence: float = math.nan
    readings: int = 0
    jump: float = 0.0  # probability that the robot has been set down elsewhere
    unfit: int = 0  # searches in a row that found it nowhere
    unexplained: int = 0  # updates in a row that neither the particles nor a slip explain
    unheard: int = 0  # updates in a row that were not taken in


class Localizer(Protocol):
    """A filter over the pose of a robot; ``belief`` is what ``start`` or the last call returned."""

    def start(self, poses: Floats, stream: Stream) -> Any:
        """Return the belief represented by poses (3, N)."""

    def predict(self, belief: Any, control: Any, stream: Stream) -> Any:
        """Return the belief after a control."""

    def update(self, belief: Any, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Any, Found]:
        """Return the belief after a control (None: no motion) and the readings at its end, and the result."""

    def surprised(self, belief: Any, readings: Sequence[Any]) -> bool:
        """Return whether readings that need not be taken in say that the robot is not where the belief has it."""

    def find(self, belief: Any) -> Found:
        """Return the current estimate."""

    def modes(self, belief: Any) -> tuple[float, ...] | None:
        """Return the share of the belief in each of its modes, in descending order; None for a single mode."""

    def shown(self, belief: Any, most: int) -> Floats:
        """Return poses (3, M), M <= most, that represent the belief in a picture."""

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        """Execute every code path of the other methods once, on a belief that is thrown away."""

    def freeze(self, belief: Any) -> Mapping[str, Any]:
        """Return the belief as plain state."""

    def thaw(self, state: Mapping[str, Any]) -> Any:
        """Return the belief from the state that freeze returned."""

    def adopt(self, belief: Any, first: Any, n: int) -> Any:
        """Return the belief of a localizer with other settings as one of this; ``first`` is a first belief of its own.

        Raises ValueError if it is one of another state.
        """


class CloudFilter(Protocol):
    """The methods that the estimator needs of a particle filter, the library's or a user's; see ParticleFilter."""

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """Return the cloud at the given poses (3, N)."""

    def predict(self, cloud: Cloud, control: Any, stream: Stream) -> Cloud:
        """Return the cloud after a control."""

    def update(self, cloud: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Cloud, Any]:
        """Return the cloud after a control (None: no motion) and the readings at its end, and the update's Report."""


class ParticleLocalizer:
    """A particle filter: the library's, or a user's with the same methods."""

    def __init__(self, cloud_filter: CloudFilter | ParticleFilter[PoseEstimate]) -> None:
        self.filter = cloud_filter

    def start(self, poses: Floats, stream: Stream) -> Cloud:
        """See Localizer."""
        return self.filter.start(poses, stream)

    def predict(self, belief: Cloud, control: Any, stream: Stream) -> Cloud:
        """See Localizer."""
        return self.filter.predict(belief, control, stream)

    def update(self, belief: Cloud, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Cloud, Found]:
        """See Localizer."""
        cloud, report = self.filter.update(belief, control, readings, stream)
        share = report.n_eff / belief.weights.size
        evidence = report.log_evidence if report.readings else math.nan
        found = Found(report.estimate, report.n_eff, share, report.outcomes, evidence, report.readings)
        doubt = report.doubt if isinstance(report, Report) else None
        if doubt is None:
            return cloud, found
        found = found._replace(jump=doubt.jumped, unfit=doubt.unfit)
        return cloud, found._replace(unexplained=doubt.unexplained, unheard=doubt.unheard)

    def surprised(self, belief: Cloud, readings: Sequence[Any]) -> bool:
        """See Localizer."""
        if not isinstance(self.filter, ParticleFilter) or not isinstance(self.filter.rescue, Relocation):
            return False
        return self.filter.rescue.surprised(belief, self.filter.models, readings)

    def find(self, belief: Cloud) -> Found:
        """See Localizer."""
        share = belief.n_eff / belief.weights.size
        return Found(pose_estimate(belief.particles, belief.weights), belief.n_eff, share)

    def modes(self, belief: Cloud) -> tuple[float, ...]:
        """See Localizer."""
        every = math.ceil(belief.weights.size / MOST_IN_MODES)
        weights = np.ascontiguousarray(belief.weights[::every])
        return tuple(mode.mass for mode in modes(belief.particles[:3, ::every], weights))

    def shown(self, belief: Cloud, most: int) -> Floats:
        """See Localizer."""
        # Chosen by weight, not by index, so that the sample represents the posterior.
        return belief.particles[:3, systematic(belief.weights, 0.5, min(most, belief.weights.size))]

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        """See Localizer."""
        cloud, _ = _rehearsed(self, poses, control, readings, stream)
        if isinstance(self.filter, ParticleFilter):
            rescue, kernel, doubt = self.filter.rescue, self.filter.regularization, None
            if rescue is not None:
                doubt = rescue.doubt(cloud, 0.0, 1, readings)._replace(share=0.5)
                rescue.doubt(cloud._replace(memory=doubt.memory), NOT_EXPLAINED, 1, readings)
            if self.filter.refinement is not None:
                apart = np.float32(0.01) * stream.part("apart").normals(*cloud.particles.shape)
                self.filter.refinement.refine(cloud._replace(particles=cloud.particles + apart), readings, stream)
            stream = stream.part("resample")
            particles, _, missing = self.filter.resample(cloud, doubt, stream)
            if kernel is not None:
                particles = self.filter.spread(kernel, particles, cloud, stream)
            if doubt is not None:
                self.filter.renew(doubt, particles, missing, readings, stream)

    def freeze(self, belief: Cloud) -> Mapping[str, Any]:
        """See Localizer."""
        return belief._asdict()

    def thaw(self, state: Mapping[str, Any]) -> Cloud:
        """See Localizer."""
        arrays = {name: np.array(state[name]) for name in ("particles", "weights", "log_weights")}
        shapes = [array.shape for array in arrays.values()]
        if len(shapes[0]) != 2 or not shapes[0][1] or shapes[1:] != [shapes[0][1:]] * 2:
            raise ValueError(f"particles, weights and their logarithms have the shapes {shapes}")
        return Cloud(**arrays, n_eff=state["n_eff"], moved=state["moved"], memory=tuple(state["memory"]))

    def adopt(self, belief: Cloud, first: Cloud, n: int) -> Cloud:
        """See Localizer: ``n`` particles are drawn by weight, unless the filter itself says how many there are."""
        _check_rows(belief.particles, first.particles)
        if len(belief.memory) != len(first.memory):
            belief = belief._replace(memory=first.memory)
        if getattr(self.filter, "sizing", None) is not None or belief.weights.size == n:
            return belief
        chosen = systematic(belief.weights, 0.5, n)
        return uniform_cloud(np.ascontiguousarray(belief.particles[:, chosen]), belief.memory)


class GaussianLocalizer:
    """A Kalman filter; several readings of the same stamp correct it one after the other."""

    def __init__(self, kalman_filter: ExtendedKalman[Any] | UnscentedKalman[Any]) -> None:
        self.filter = kalman_filter

    def start(self, poses: Floats, stream: Stream) -> Gaussian:
        """Return mean and covariance of the poses, and of the further state that the motion model draws."""
        states = np.asarray(self.filter.motion.particles(poses, stream), dtype=np.float64)
        pose = pose_estimate(states, np.full(states.shape[1], 1.0 / states.shape[1]))
        mean = np.concatenate([pose.mean, states[3:].mean(axis=1)])
        deviation = kalman.wrap_rows(states - mean[:, None], (2,))
        count = states.shape[1]
        return Gaussian(mean, weighted_covariance(deviation, np.ones(count)) / count)

    def predict(self, belief: Gaussian, control: Any, stream: Stream) -> Gaussian:  # noqa: ARG002
        """See Localizer."""
        return self.filter.predict(belief, control)

    def update(self, belief: Gaussian, control: Any, readings: Sequence[Any], stream: Stream) -> tuple[Gaussian, Found]:
        """See Localizer; readings correct the belief in the order given."""
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

    def surprised(self, belief: Gaussian, readings: Sequence[Any]) -> bool:  # noqa: ARG002
        """See Localizer: never."""
        return False

    def find(self, belief: Gaussian) -> Found:
        """See Localizer; a Gaussian has no effective sample size."""
        return Found(PoseEstimate(belief.mean[:3], belief.covariance[:3, :3]), 0.0, 1.0)

    def modes(self, belief: Gaussian) -> None:
        """Return None: a Gaussian has a single mode."""

    def shown(self, belief: Gaussian, most: int) -> Floats:
        """Return the mean, and points around it with the belief's covariance."""
        offsets = kalman.symmetric_offsets(belief.covariance, float(belief.mean.size))
        states = np.concatenate([belief.mean[:, None], belief.mean[:, None] + offsets], axis=1)
        return states[:3, :: math.ceil(states.shape[1] / most)]

    def rehearse(self, poses: Floats, control: Any, readings: Sequence[Any], stream: Stream) -> None:
        """See Localizer."""
        _rehearsed(self, poses, control, readings, stream)

    def freeze(self, belief: Gaussian) -> Mapping[str, Any]:
        """See Localizer."""
        return belief._asdict()

    def thaw(self, state: Mapping[str, Any]) -> Gaussian:
        """See Localizer."""
        mean, covariance = np.array(state["mean"]), np.array(state["covariance"])
        if covariance.shape != mean.shape * 2 or mean.ndim != 1:
            raise ValueError(f"mean and covariance have the shapes {mean.shape} and {covariance.shape}")
        return Gaussian(mean, covariance)

    def adopt(self, belief: Gaussian, first: Gaussian, n: int) -> Gaussian:  # noqa: ARG002
        """See Localizer."""
        _check_rows(belief.mean, first.mean)
        return belief


def _check_rows(state: Floats, first: Floats) -> None:
    if state.shape[0] != first.shape[0]:
        raise ValueError(f"a belief of {state.shape[0]} numbers a state; expected {first.shape[0]}")


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
