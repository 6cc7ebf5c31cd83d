"""Refinement of the belief by scan matching: particles find the mode, a sharper model says where in it the robot is.

A particle filter's likelihood has to be wide, or hardly any particle would survive it, and so the mean is blunt. Near
the mode the belief is close to a Gaussian, of which any number of draws can be had: compared with the scan by a sharp
model they tell the pose to a fraction of a cell.
"""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import msgspec
import numpy as np

from dynpf.covariance import semidefinite_root
from dynpf.filters.cloud import Cloud, normalized_weights
from dynpf.filters.estimate import PoseEstimate, pose_estimate
from dynpf.filters.models import Evidence, Models
from dynpf.measurement.model import MeasurementModel
from dynpf.params import validated
from dynpf.portable import inverse, product
from dynpf.rng import Stream
from dynpf.se2 import wrap_angle
from dynpf.types import Count, Floats, NonNegative, Positive, Rate

__all__ = ["Matchable", "Refinement", "ScanMatching", "ScanMatchingParams"]


class Refinement(Protocol):
    """Moves the particles of a weighted cloud to where the readings say more exactly that they are."""

    def refine(self, cloud: Cloud, readings: Sequence[Any], stream: Stream) -> Floats:
        """Return the particles (D, N) after an update by the readings; the same array where nothing can be refined."""


@runtime_checkable
class Matchable(Protocol):
    """A measurement model that can also be had sharper, and of more beams."""

    def matching(self, sigma: float, beams: int, tempering: float) -> MeasurementModel[Any]:
        """Return the model of the same map by the noise ``sigma`` (m), so many beams, and this exponent."""


class ScanMatchingParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="scan_matching"
):
    """How sharply scans are compared with the map near the mode."""

    draws: Count = 2000
    sigma: Positive = 0.05  # m, of a beam's end
    max_beams: Count = 180
    # Exponent of the product of beams. The map's errors and the cells' sides are common to many beams, and to scan
    # after scan; so the covariance is honest only if each counts for little.
    tempering: Rate = 0.06
    # Standard deviations of what no number of beams tells better: the map's own errors, and those of stamps and mounts.
    floor_m: NonNegative = 0.0
    floor_rad: NonNegative = 0.0
    position_most: Positive = 0.5  # m, standard deviation of the belief, above which there is no one mode to refine
    heading_most: Positive = 0.25  # rad


class ScanMatching:
    """Importance sampling from the belief's Gaussian, by a sharp likelihood; then the particles get its moments.

    Draws from the Gaussian of the weighted particles are weighed by the sharp model, as a scan matcher's
    likelihood is sampled for the improved proposal of Grisetti, Stachniss and Burgard (2007). Their mean m'
    and covariance L' L'^T become those of the particles, of mean m and covariance L L^T, by x' = m' + L' L^-1 (x - m),
    as in square root filters of ensembles (Tippett et al., 2003): no particle is copied, and the next update has
    as many different ones as this.
    """

    def __init__(self, params: ScanMatchingParams, models: Models) -> None:
        """Raises ValueError where no measurement model is Matchable, or a parameter is out of its range."""
        self.params = validated(params)
        sharp = {
            taken: model.matching(params.sigma, params.max_beams, params.tempering)
            for taken, model in models.measurements.items()
            if isinstance(model, Matchable)
        }
        if not sharp:
            raise ValueError("scan matching needs a measurement model that can be sharpened, such as likelihood_field")
        self._models = Models(models.motion, sharp, models.threads)

    def refine(self, cloud: Cloud, readings: Sequence[Any], stream: Stream) -> Floats:
        """See Refinement."""
        taken = [reading for reading in readings if type(reading) in self._models.measurements]
        before = pose_estimate(cloud.particles, cloud.weights)
        if not taken or not self._is_one_mode(before):
            return cloud.particles
        after = self.matched(before, taken, stream)
        return cloud.particles if after is None else _moved(cloud.particles, before, after)

    def matched(self, belief: PoseEstimate, readings: Sequence[Any], stream: Stream) -> PoseEstimate | None:
        """Return mean and covariance of a Gaussian belief given the readings; None where they say nothing."""
        noise = product(semidefinite_root(belief.covariance), stream.normals(3, self.params.draws))
        poses = (belief.mean[:, None] + noise).astype(np.float32)
        evidence = [Evidence(self._models.measurements[type(reading)], reading, 1) for reading in readings]
        weights, log_sum = normalized_weights(self._models.log_likelihood(poses, evidence))
        if not np.isfinite(log_sum):
            return None
        mean, covariance = pose_estimate(poses, weights)
        floor_m, floor_rad = self.params.floor_m * self.params.floor_m, self.params.floor_rad * self.params.floor_rad
        return PoseEstimate(mean, covariance + np.diag([floor_m, floor_m, floor_rad]))

    def _is_one_mode(self, belief: PoseEstimate) -> bool:
        x, y, turn = np.sqrt(np.diagonal(belief.covariance)).tolist()
        # Particles that are copies of one have nothing to be moved along.
        narrow = max(x, y) <= self.params.position_most and turn <= self.params.heading_most
        return bool(narrow and min(x, y, turn) > LEAST_SIGMA)


LEAST_SIGMA = 1e-4
"""Metres and radians: a belief that is narrower than float32 can tell poses apart is not refined."""


def _moved(particles: Floats, before: PoseEstimate, after: PoseEstimate) -> Floats:
    """Return particles (D, N) of one Gaussian moved so that their poses have the moments of another."""
    deviation = particles[:3] - before.mean[:, None]
    deviation[2] = wrap_angle(deviation[2])
    try:
        change = product(semidefinite_root(after.covariance), inverse(semidefinite_root(before.covariance)))
    except ValueError:  # flat by rounding: moved as they are
        change = np.eye(3)
    poses = after.mean[:, None] + product(change, deviation)
    poses[2] = wrap_angle(poses[2])
    moved = particles.copy()
    moved[:3] = poses
    return moved
