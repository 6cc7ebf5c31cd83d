"""Survivors that are copies of one another set apart: draws from a smooth density in place of the particles' own."""

import math
from typing import Protocol

import msgspec
import numpy as np

from dynpf.covariance import semidefinite_root
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import weighted_covariance
from dynpf.portable import power, product
from dynpf.rng import Stream
from dynpf.se2 import circular_mean, wrap_angle
from dynpf.types import FloatArray, Floats, NonNegative

__all__ = ["GaussianKernel", "Regularization"]


class Regularization(Protocol):
    """A smooth density around survivors."""

    def spread(self, survivors: Floats, cloud: Cloud, stream: Stream) -> Floats:
        """Return the survivors (D, M) of a weighted cloud, each moved by its own draw from a kernel."""


class GaussianKernel(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="gaussian_kernel"
):
    """The Gaussian kernel that is optimal for a Gaussian density (Musso, Oudjane and Le Gland, 2001, eq. 12.2.9).

    Its covariance is the cloud's times h^2, h = (4 / (N (D + 2)))^(1 / (D + 4)); drawn together by sqrt(1 - h^2) the
    survivors keep mean and covariance (Liu and West, 2001).
    """

    scale: NonNegative = 1.0  # of the kernel's width, relative to the optimal one
    # Without, the covariance grows by 1 + h^2 at each resampling. With, several modes are drawn towards their mean.
    shrink: bool = False
    headings: bool = True  # row 2 is an angle

    def spread(self, survivors: Floats, cloud: Cloud, stream: Stream) -> Floats:
        """See Regularization."""
        size, count = survivors.shape
        mean: FloatArray = np.asarray(np.sum(cloud.weights * cloud.particles, axis=1, dtype=np.float64))
        if self.headings:
            mean[2] = circular_mean(cloud.particles[2], cloud.weights)
        covariance = weighted_covariance(self._deviation(cloud.particles, mean), cloud.weights)
        width = min(self.scale * power(4.0 / (count * (size + 2.0)), 1.0 / (size + 4.0)), 1.0)
        deviation = self._deviation(survivors, mean)
        if self.shrink:
            deviation *= math.sqrt(1.0 - width * width)
        root = semidefinite_root(covariance)
        noise = product(width * root, stream.normals(size, count))
        spread: Floats = (mean[:, None] + deviation + noise).astype(survivors.dtype)
        return spread

    def _deviation(self, particles: Floats, mean: FloatArray) -> FloatArray:
        deviation = particles - mean[:, None]
        if self.headings:
            deviation[2] = wrap_angle(deviation[2])
        return deviation
