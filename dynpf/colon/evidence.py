"""What a capsule's ranges say of a map that may have changed, and in which form kernels take and give it.

Beams are rows, particles columns: B beams, N particles, J nodes of the wall, S places of a bulge. Arrays are float32
but for indices. Everything in the map's frame and in map units (px), which are cells.
"""

from typing import NamedTuple

import numpy as np

from dynpf.filters.resampling import Indices
from dynpf.types import Floats

__all__ = ["Beams", "Bulges", "Displacements", "Evidence", "Stops", "WallNoise"]


class Beams(NamedTuple):
    """What was read, and from where.

    Poses, (N,) each: ``x`` and ``y`` in cells from the middle of cell (0, 0), heading ``theta``. Ranges ``read`` (B,)
    at ``angles`` (B,), and what an unchanged map lets expect there, ``expected`` (B, N).
    """

    x: Floats
    y: Floats
    theta: Floats
    angles: Floats
    read: Floats
    expected: Floats


class Displacements(NamedTuple):
    """How far the nodes of a wall have moved: a Gaussian for each particle.

    ``means`` (M, J), of which ``ancestors`` (N,) is the index of each particle's; one ``covariance`` (J, J), and the
    probabilities ``chances`` (J,) that the nodes have moved at all.
    """

    means: Floats
    ancestors: Indices
    covariance: Floats
    chances: Floats


class WallNoise(NamedTuple):
    """The noise of ranges (``dynpf.colon.beams.Noise``), and of where a moved wall is."""

    sigma: float
    wide: float
    outliers: float
    range_max: float
    roughness: float  # of where a wall is about what its nodes say
    sigma_range: float  # of the sensor alone; across a wall it shrinks as the beam slants
    bulge_roughness: float  # of how far a wall is from a bulge's bell, besides its roughness


class Stops(NamedTuple):
    """Where a wall stopped each beam, if it has moved, (B, N) each."""

    blame: Floats  # probability that a moved wall stopped the beam
    distance: Floats  # how far beyond the reference wall that was
    variance: Floats  # of that distance
    facing: Floats  # cosine of the angle between the beam and the wall's normal
    unmoved: Floats  # density of the range if the wall has not moved
    node: Indices  # the node before that point of the wall, -1 where a beam carries no information about a wall
    share: Floats  # of the way from there to the following node

    @classmethod
    def empty(cls, beams: int, particles: int) -> "Stops":
        """Return arrays for a kernel to write."""
        blame, distance, variance, facing, unmoved, share = np.empty((6, beams, particles), dtype=np.float32)
        return cls(blame, distance, variance, facing, unmoved, np.empty(share.shape, dtype=np.int32), share)


class Bulges(NamedTuple):
    """What is known of bulges at each particle: displacements that are a bell of some height, at one of S places.

    ``log_shapes`` (N, S + 1): log-probabilities of the places and, last, of no bulge; ``heights`` and ``variances``
    (N, S) of each.
    """

    log_shapes: Floats
    heights: Floats
    variances: Floats


class Evidence(NamedTuple):
    """Log-likelihoods (K + 1, N) of the listed maps and of a changed one, and what there is to learn of its walls."""

    log_likelihood: Floats
    stops: Stops
    bulges: Bulges
