"""Sampling importance resampling: propagate, reweight, resample (Gordon et al., 1993; LANDMARK section 4).

The filter is composed of a motion model, one measurement model for each kind of reading, and a resampling scheme
that says when and how. It holds no particles: they go in and come out, so that whoever owns them can keep them.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, NamedTuple, Protocol

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf.filters.resampling import effective_sample_size, normalize_log_weights, systematic
from dynpf.measurement.model import MeasurementModel
from dynpf.motion.model import MotionModel, Twist
from dynpf.se2 import FloatArray

__all__ = ["Cloud", "Outcome", "Resampling", "Sir", "SystematicParams", "SystematicResampling"]


class Cloud(NamedTuple):
    """Particles, shape (D, N), and their log-weights, shape (N,), normalized so that their exponentials sum to 1."""

    particles: FloatArray
    log_weights: FloatArray

    @property
    def weights(self) -> FloatArray:
        return np.exp(self.log_weights)


class Outcome(StrEnum):
    """What became of a reading."""

    USED = "used"
    REFUSED = "refused"  # not plausible: outside the gate, not a number, or of nothing in the map
    IMPOSSIBLE = "impossible"  # no particle explains it: the weights stayed as they were


class Resampling(Protocol):
    """When and how survivors are chosen."""

    def due(self, weights: FloatArray) -> bool:
        """Return whether normalized weights (N,) are so uneven that it is time to resample."""

    def select(self, weights: FloatArray, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return the indices of the N particles that replace the old ones."""


class SystematicParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="systematic"
):
    """Systematic resampling when the effective sample size falls below ``threshold`` times N; 1 is nearly always."""

    threshold: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.5


class SystematicResampling:
    """One random number for all particles: the least variance of the usual schemes."""

    def __init__(self, params: SystematicParams) -> None:
        self.params = params

    def due(self, weights: FloatArray) -> bool:
        """Return whether 1 / sum(w^2) is below the threshold."""
        return effective_sample_size(weights) < self.params.threshold * weights.size

    def select(self, weights: FloatArray, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return the survivors' indices, ascending."""
        return systematic(weights, rng.random())


class Sir:
    """The filter: a motion model, a measurement model for each type of reading, and a resampling scheme."""

    def __init__(
        self, motion: MotionModel, measurements: Mapping[type, MeasurementModel[Any]], resampling: Resampling
    ) -> None:
        self.motion = motion
        self.measurements = dict(measurements)
        self.resampling = resampling

    def start(self, poses: FloatArray, rng: np.random.Generator) -> Cloud:
        """Return a cloud of equal weights at the given poses (3, N); raises ValueError when there are none."""
        count = poses.shape[1]
        if count == 0:
            raise ValueError("a particle filter needs at least one pose to start from; got shape (3, 0)")
        return Cloud(self.motion.particles(poses, rng), np.full(count, -np.log(count)))

    def predict(self, cloud: Cloud, twist: Twist, duration: float, rng: np.random.Generator) -> Cloud:
        """Return the cloud after ``duration`` seconds of ``twist``."""
        return Cloud(self.motion.propagate(cloud.particles, twist, duration, rng), cloud.log_weights)

    def reweight(self, cloud: Cloud, reading: object) -> tuple[Cloud, Outcome]:
        """Return the cloud weighted by one reading, and what became of it.

        Raises KeyError for a type of reading that no measurement model takes.
        """
        model = self.measurements[type(reading)]
        if not model.plausible(cloud.particles, cloud.weights, reading):
            return cloud, Outcome.REFUSED
        log_weights = cloud.log_weights + model.log_likelihood(cloud.particles, reading)
        weights, log_sum = normalize_log_weights(log_weights)
        if np.isneginf(log_sum):
            return cloud, Outcome.IMPOSSIBLE
        with np.errstate(divide="ignore"):
            return Cloud(cloud.particles, np.log(weights)), Outcome.USED

    def resample(self, cloud: Cloud, rng: np.random.Generator) -> Cloud:
        """Return the cloud with its survivors at equal weights if that is due, else as it is."""
        weights = cloud.weights
        if not self.resampling.due(weights):
            return cloud
        survivors = self.resampling.select(weights, rng)
        return Cloud(cloud.particles[:, survivors], np.full(survivors.size, -np.log(survivors.size)))
