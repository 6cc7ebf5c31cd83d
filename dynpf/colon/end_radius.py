"""A family of maps with one number that nobody knows: COLON's tubes whose end is a circle of some radius.

A particle is a pose and a radius. Ranges are expected by casting rays in the two listed members between whose radii a
particle's lies, and going from one to the other in proportion. A change of the radius is proposed to half of the
particles at every step, and weighed by how improbable it is.
"""

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.colon import exact
from dynpf.colon.annealing import annealed
from dynpf.colon.beams import ANGLES, Noise, checked_ranges, dominant_mode, expected_ranges, listed_log_likelihood
from dynpf.filters.cloud import Cloud, uniform_cloud, weighted_cloud
from dynpf.filters.resampling import Indices
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Count, FloatArray, Floats, NonNegative, Positive

__all__ = ["EndRadius", "EndRadiusParams", "RadiusFinding"]


class EndRadiusParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Lengths in map units (px)."""

    n: Count = 100
    motion: CapsuleStepParams = CapsuleStepParams()
    sigma_map: Positive = 2.0  # of a range, in a map that is right and between two that are
    sigma_range: NonNegative = 0.0  # of the sensor's noise
    outliers: Annotated[float, Meta(gt=0.0, lt=0.9)] = 0.002
    change: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.1  # probability that the radius is another after a step
    growth: NonNegative = 0.5  # standard deviation by which it also moves on within a step


class RadiusFinding(NamedTuple):
    """``pose`` (3,) of the heaviest cluster; mean and standard deviation of the radius; the probability that it has
    changed by now from what it was before the update by more than ``EndRadius.NOTABLE``.
    """

    pose: FloatArray
    radius: float
    radius_deviation: float
    changed: float


class EndRadius:
    """A filter over poses and the radius; it has no state: clouds (4, N) of x, y, theta, radius go in and come out."""

    NOTABLE = 5.0  # px

    def __init__(self, params: EndRadiusParams, members: Mapping[float, OccupancyGrid]) -> None:
        """Take members of the family by their radii; raises ValueError for fewer than two."""
        self.params = validated(params)
        if len(members) < 2:
            raise ValueError(f"{len(members)} members of a family: expected two at least, to go from one to another")
        self.radii = np.array(sorted(members), dtype=np.float32)
        self._casters = tuple(RayCaster(members[radius]) for radius in sorted(members))
        self._motion = CapsuleStep(params.motion)
        self._noise = Noise.of(params.sigma_map, params.sigma_range, params.outliers)

    def start(self, poses: Floats, radius: float) -> Cloud:
        """Return the cloud at poses (3, N) where the radius is known."""
        return uniform_cloud(np.vstack((poses, np.full(poses.shape[1], radius))).astype(np.float32))

    def update(
        self, cloud: Cloud, motion: CapsuleMotion | None, ranges: Floats, stream: Stream
    ) -> tuple[Cloud, RadiusFinding]:
        """Return the cloud after a motion (None: none) and ranges (B,) at its end, and what was found."""
        read = checked_ranges(ranges)
        before = float(np.sum(cloud.weights * cloud.particles[3], dtype=np.float64))
        particles = cloud.particles
        if motion is not None:
            particles = self._motion.propagate(particles, motion, stream.part("motion"))
        proposed, log_weights = self._propose_radii(particles, cloud.log_weights, stream.part("radius"))
        weighted, _ = weighted_cloud(proposed, log_weights)

        def likelihood(particles: Floats, _: Indices) -> tuple[Floats, None]:
            expected = self._expected(particles)
            return listed_log_likelihood(expected, read, self._noise), None

        found = annealed(weighted, likelihood, self.params.n, stream).cloud
        return found, self._finding(found, before)

    def _propose_radii(self, particles: Floats, log_weights: Floats, stream: Stream) -> tuple[Floats, Floats]:
        """Return particles of which every other one has another radius, and log-weights that make up for it."""
        params, count = self.params, particles.shape[1]
        proposed = particles.copy()
        proposed[3] += np.float32(params.growth) * stream.normals(1, count)[0]
        if params.change > 0.0:
            redrawn = np.arange(count) % 2 == 1
            low, high = self.radii[0], self.radii[-1]
            anywhere = low + (high - low) * stream.part("anew").uniforms(1, count)[0]
            proposed[3] = np.where(redrawn, anywhere, proposed[3])
            log_weights = log_weights + exact.log(np.where(redrawn, 2.0 * params.change, 2.0 * (1.0 - params.change)))
        proposed[3] = np.clip(proposed[3], self.radii[0], self.radii[-1])
        return proposed, log_weights

    def _expected(self, particles: Floats) -> Floats:
        """Return the ranges (B, N) that particles (4, N) expect."""
        radius = np.clip(particles[3], self.radii[0], self.radii[-1])
        lower = np.clip(np.searchsorted(self.radii, radius, side="right") - 1, 0, self.radii.size - 2)
        share = (radius - self.radii[lower]) / (self.radii[lower + 1] - self.radii[lower])
        expected = np.zeros((ANGLES.size, particles.shape[1]), dtype=np.float32)
        for index, caster in enumerate(self._casters):
            part = np.where(lower == index, 1 - share, np.where(lower + 1 == index, share, 0))
            of = np.flatnonzero(part)
            if of.size:
                expected[:, of] += part[of] * expected_ranges(caster, particles[:3, of])
        return expected

    def _finding(self, cloud: Cloud, before: float) -> RadiusFinding:
        weights, radius = cloud.weights.astype(np.float64), cloud.particles[3]
        mean = float(np.sum(weights * radius))
        deviation = math.sqrt(float(np.sum(weights * np.square(radius - mean))))
        changed = float(np.sum(weights[np.abs(radius - before) > self.NOTABLE]))
        return RadiusFinding(dominant_mode(cloud).mean, mean, deviation, changed)
