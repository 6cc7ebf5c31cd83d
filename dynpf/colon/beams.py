"""The capsule's five ranges: what a map lets expect, and how likely that makes what was read."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynpf import kernels
from dynpf.colon.world import BEAMS, RANGE_MAX
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import Mode, modes
from dynpf.maps.raycast import RayCaster
from dynpf.portable import hypot
from dynpf.types import Floats

__all__ = [
    "ANGLES",
    "Noise",
    "checked_ranges",
    "dominant_mode",
    "expected_in_each",
    "expected_ranges",
    "listed_log_likelihood",
]


class Noise(NamedTuple):
    """Standard deviations of most ranges and of a few, and the share that is anything up to the cap; px."""

    sigma: float
    wide: float
    outliers: float
    range_max: float = RANGE_MAX

    @classmethod
    def of(cls, sigma_map: float, sigma_range: float, outliers: float) -> "Noise":
        """Return a sensor's noise in a map that is right to within ``sigma_map``, near its edges to six times that."""
        return cls(hypot(sigma_map, sigma_range), hypot(6.0 * sigma_map, sigma_range), outliers)


ANGLES = np.array(BEAMS, dtype=np.float32)


def checked_ranges(ranges: Floats) -> Floats:
    """Return ranges (B,) in float32, none above the cap, NaN where nothing was read; raises ValueError if not five."""
    read = np.array(ranges, dtype=np.float32)
    if read.shape != ANGLES.shape:
        raise ValueError(f"ranges of shape {read.shape}; expected one for each of {ANGLES.size} beams")
    read[~(read >= 0.0)] = np.nan
    return np.minimum(read, np.float32(RANGE_MAX))


def expected_ranges(caster: RayCaster, poses: Floats) -> Floats:
    """Return the ranges (B, N) that poses (3, N) or particles let expect in a map."""
    return expected_in_each((caster,), poses)[0]


def expected_in_each(casters: Sequence[RayCaster], poses: Floats) -> list[Floats]:
    """Return the ranges (B, N) that poses (3, N) or particles let expect in each of several maps."""
    directions = (poses[2] + ANGLES[:, None]).ravel()
    x, y = np.tile(poses[0], ANGLES.size), np.tile(poses[1], ANGLES.size)
    shape = ANGLES.size, poses.shape[1]
    return [caster.ranges(x, y, directions, RANGE_MAX).reshape(shape) for caster in casters]


def listed_log_likelihood(expected: Floats, read: Floats, noise: Noise) -> Floats:
    """Return the log-likelihood (N,) of ranges (B,) where ``expected`` (B, N) are right, up to their noise."""
    log_likelihood = np.empty(expected.shape[1], dtype=np.float32)
    kernels.colon.listed(expected, read, noise, log_likelihood)
    return log_likelihood


def dominant_mode(cloud: Cloud) -> Mode:
    """Return the heaviest cluster of poses, among cells of 20 px and 30 degrees."""
    return modes(cloud.particles, cloud.weights, cell_m=20.0, cell_rad=math.radians(30.0), min_mass=0.0)[0]
