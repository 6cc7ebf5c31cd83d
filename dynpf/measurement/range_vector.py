"""A few ranges at fixed directions inside a closed tube (COLON: the capsule's five sensors)."""

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from dynpf import kernels
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.params import validated
from dynpf.portable import whole
from dynpf.types import Floats, Positive, Rate

__all__ = ["RangeVector", "RangeVectorModel", "RangeVectorParams", "closed_in"]


class RangeVector(NamedTuple):
    """Ranges read at one instant, shape (B,), in the map's metres; +inf where a beam met nothing."""

    ranges: Floats


class RangeVectorParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="range_vector"
):
    """Beams, noise and trust. Lengths are the map's: metres, or cells where its resolution is 1."""

    # rad from the heading, anticlockwise
    angles: Annotated[tuple[float, ...], Meta(min_length=1)] = (
        -math.pi / 3,
        -math.pi / 6,
        0.0,
        math.pi / 6,
        math.pi / 3,
    )
    range_max: Positive = 500.0  # m: ranges, read and expected, are capped here
    sigma: Positive = 100.0  # m
    # Share of readings that come from anywhere, uniform up to range_max, for each beam by itself.
    outlier_fraction: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.0
    tempering: Rate = 1.0  # exponent of the likelihood


class RangeVectorModel:
    """exp(-|expected - read|^2 / (2 sigma^2)) inside the map, zero outside of it and in its walls.

    Inside is where rays along the grid's four axis directions all meet a wall. A range that is NaN or negative tells
    nothing: that beam is left out, and a reading without any other is not admitted. The likelihood is that of Gaussian
    errors up to a constant factor.
    """

    def __init__(self, params: RangeVectorParams, grid: OccupancyGrid) -> None:
        """Raises ValueError for a parameter out of its range."""
        self.params = validated(params)
        self._grid = grid
        self._caster = RayCaster(grid)
        self._closed_in = closed_in(grid.occupied)

    def admit(self, particles: Floats, weights: Floats, reading: RangeVector) -> RangeVector | None:  # noqa: ARG002
        """Return the reading, None if no beam carries information; raises ValueError as the likelihood does."""
        return reading if np.isfinite(self._capped(reading)).any() else None

    def count(self, reading: RangeVector) -> int:
        """Return the number of ranges."""
        return len(reading.ranges)

    def log_likelihood(self, particles: Floats, reading: RangeVector) -> Floats:
        """Return the tempered log-likelihood for each particle, shape (N,), float32: -inf outside the map.

        Raises ValueError where the reading has ranges, but not one for each beam.
        """
        params = self.params
        capped = self._capped(reading)
        telling = np.flatnonzero(np.isfinite(capped))
        log_likelihood = np.zeros(particles.shape[1], dtype=np.float32)
        if not telling.size:
            return log_likelihood
        inside = self.inside(particles)
        x, y, theta = np.ascontiguousarray(particles[:3, inside], dtype=np.float32)
        total = np.zeros(x.size, dtype=np.float32)
        for beam in telling:
            expected = self._caster.ranges(x, y, theta + np.float32(params.angles[beam]), params.range_max)
            total += self._log_beam((expected - capped[beam]) / np.float32(params.sigma))
        log_likelihood[:] = -np.inf
        log_likelihood[inside] = np.float32(params.tempering) * total
        return log_likelihood

    def inside(self, particles: Floats) -> NDArray[np.bool_]:
        """Return whether each particle (D, N) is inside the map, shape (N,)."""
        with np.errstate(invalid="ignore"):
            column, row = self._grid.to_cells(particles[0], particles[1])
        height, width = self._closed_in.shape
        # Comparisons, before anything is made an integer, also put NaN and infinity outside.
        within = (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
        inside = np.zeros(within.shape, dtype=np.bool_)
        cells = whole(row[within], 0, height - 1), whole(column[within], 0, width - 1)
        inside[within] = self._closed_in[cells]
        return inside

    def _capped(self, reading: RangeVector) -> NDArray[np.float32]:
        """Return the ranges, none above the cap and NaN where nothing was read, (B,)."""
        ranges = np.array(reading.ranges, dtype=np.float32)
        beams = len(self.params.angles)
        if ranges.shape not in {(0,), (beams,)}:
            raise ValueError(f"a reading of shape {ranges.shape}; expected one range for each of {beams} beams")
        ranges[~(ranges >= 0.0)] = np.nan
        return np.minimum(ranges, np.float32(self.params.range_max))

    def _log_beam(self, deviation: Floats) -> Floats:
        share = np.float32(self.params.outlier_fraction)
        if not share:
            log_density: Floats = np.float32(-0.5) * (deviation * deviation)
            return log_density
        uniform = np.float32(math.sqrt(2.0 * math.pi) * self.params.sigma / self.params.range_max)
        mixed = np.empty(deviation.size, dtype=np.float32)
        kernels.beam.log_mixture(deviation, share, uniform, mixed)
        return mixed


def closed_in(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells of (H, W) are no wall and have one somewhere in each of the four axis directions."""
    before = [np.logical_or.accumulate(occupied, axis=axis) for axis in (0, 1)]
    after = [np.flip(np.logical_or.accumulate(np.flip(occupied, axis), axis=axis), axis) for axis in (0, 1)]
    closed: NDArray[np.bool_] = before[0] & before[1] & after[0] & after[1] & ~occupied
    return closed
