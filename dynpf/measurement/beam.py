"""The beam model: a range is what a ray through the map predicts, or one of three ways to differ from that.

INDOOR takes it from Thrun, Burgard and Fox, Probabilistic Robotics (2005), section 6.3.
"""

import math
from typing import NamedTuple

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.scan import Scan
from dynpf.params import validated
from dynpf.portable import erf, exp, expm1
from dynpf.types import Count, FloatArray, Floats, Positive, Rate, Share

__all__ = ["BeamModel", "BeamParams", "BeamTable", "densities", "share_within"]


class BeamParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="beam"):
    """Shares of the four parts of the mixture, which sum to one, their scales, and how beams are put together.

    Raises ValueError where the shares do not sum to one within 1e-6.
    """

    z_hit: Share = 0.7  # the wall of the map, with a Gaussian error
    z_short: Share = 0.1  # something before it, the likelier the nearer
    z_max: Share = 0.05  # no return: the greatest range
    z_rand: Share = 0.15  # anything up to the greatest range
    sigma_hit: Positive = 0.15  # m
    lambda_short: Positive = 0.5  # 1/m
    max_beams: Count = 60
    # Exponent of the product: beams of one scan share their errors, so each counts for less than if it stood alone.
    tempering: Rate = 1.0
    # Pose of the sensor, metres and radians, seen from where the scan says that it is on the robot.
    sensor_x: float = 0.0
    sensor_y: float = 0.0
    sensor_theta: float = 0.0

    def __post_init__(self) -> None:
        """Check what no single range can say."""
        shares = (self.z_hit, self.z_short, self.z_max, self.z_rand)
        total = math.fsum(shares)
        if not abs(total - 1.0) <= 1e-6:
            raise ValueError(f"BeamParams: z_hit, z_short, z_max, z_rand = {shares} sum to {total}, must to 1")


class BeamTable(NamedTuple):
    """The beams of a scan that can be believed, and their log densities by the length of the ray.

    ``angles`` (B,) in the robot's frame; ``log_densities`` (B, K) at lengths from 0 to ``range_max`` that are
    1 / ``per_length`` metres apart; ``sensor`` (2,) where they start in that frame, in cells. Float32.
    """

    angles: Floats
    log_densities: Floats
    per_length: float
    range_max: float
    sensor: Floats


class BeamModel:
    """The model of a scan in an occupancy grid, with exact rays (``RayCaster``: unknown cells do not stop them).

    A particle off the grid, in an occupied cell or without a finite pose is impossible: -inf. One in an unknown cell is
    allowed. A scan of no usable beam, or without a finite greatest range, is not admitted: its log-likelihood is zero.

    Log densities are taken from a table over the length of the ray, linear between nodes that are at most half a cell
    and an eighth of sigma_hit apart: the value lies between those of the lengths at both nodes. That is within 0.01 of
    the exact logarithm for the parameters given by default, but for lengths within two nodes of zero, where p_short is
    steep, or within one of the reading itself: there p_short sets in, with a jump that the table spreads over one
    interval. Densities below 1.2e-38 count as that.
    """

    def __init__(self, params: BeamParams, grid: OccupancyGrid) -> None:
        """Make the caster of rays; raises ValueError where a parameter is out of its range."""
        self.params = validated(params)
        self.grid = grid
        self.caster = RayCaster(grid)
        self._spacing = min(0.5 * grid.resolution, 0.125 * params.sigma_hit)
        self._peaks: tuple[float, tuple[Floats, Floats, Floats]] | None = None

    def admit(self, particles: Floats, weights: Floats, reading: Scan) -> BeamTable | None:  # noqa: ARG002
        """Return the table of the beams that carry information, at most ``max_beams``; None if there are none."""
        table = self._table(reading)
        return table if table.angles.size else None

    def count(self, reading: BeamTable) -> int:
        """Return how many beams there are in what ``admit`` has returned."""
        return reading.angles.size

    def log_likelihood(self, particles: Floats, reading: Scan | BeamTable) -> Floats:
        """Return log p(scan | particle) to the power of ``tempering``, shape (N,) float32."""
        table = self._table(reading) if isinstance(reading, Scan) else reading
        if not table.angles.size:
            return np.zeros(particles.shape[1], dtype=np.float32)
        x, y, theta = (np.ascontiguousarray(row, dtype=np.float32) for row in particles[:3])
        total = np.empty(x.size, dtype=np.float32)
        caster = self.caster
        kernels.beam.sum_over_beams(x, y, theta, table, caster.tables, caster.size, caster.frame, total)
        if self.params.tempering != 1.0:
            total *= np.float32(self.params.tempering)
        return total

    def _table(self, scan: Scan) -> BeamTable:
        params, range_max = self.params, float(scan.range_max)
        if not (math.isfinite(range_max) and range_max > 0.0):
            return BeamTable(np.empty(0, np.float32), np.empty((0, 0), np.float32), 1.0, 1.0, np.zeros(2, np.float32))
        angles, ranges, *_ = scan.usable(params.max_beams)
        lengths, hit, short = self._at_their_peaks(range_max)
        rest = np.where(ranges < np.float32(range_max), params.z_rand / range_max, params.z_max).astype(np.float32)
        scales = np.array([params.sigma_hit, params.lambda_short], dtype=np.float32)
        table = np.empty((ranges.size, lengths.size), dtype=np.float32)
        kernels.beam.fill_log_densities(ranges, lengths, hit, short, rest, scales, table)
        mount = scan.mounted(params.sensor_x, params.sensor_y, params.sensor_theta)
        sensor = mount[:2] / np.float32(self.grid.resolution)
        return BeamTable(angles + mount[2], table, (lengths.size - 1) / range_max, range_max, sensor)

    def _at_their_peaks(self, range_max: float) -> tuple[Floats, Floats, Floats]:
        """Return the table's lengths (K,), and p_hit at and p_short before each, times their shares."""
        if self._peaks is None or self._peaks[0] != range_max:
            params = self.params
            lengths = np.linspace(0.0, range_max, math.ceil(range_max / self._spacing) + 1)
            hit = params.z_hit * densities(lengths, lengths, range_max, params.sigma_hit, params.lambda_short)[0]
            none = np.zeros_like(lengths)
            short = params.z_short * densities(none, lengths, range_max, params.sigma_hit, params.lambda_short)[1]
            self._peaks = (range_max, (lengths.astype(np.float32), hit.astype(np.float32), short.astype(np.float32)))
        return self._peaks[1]


def densities(
    ranges: FloatArray, expected: FloatArray, range_max: float, sigma_hit: float, lambda_short: float
) -> FloatArray:
    """Return p_hit, p_short, p_max and p_rand of ranges (n,) where rays have the ``expected`` lengths (n,): (4, n).

    Thrun et al. (2005), eq. 6.4 to 6.11; metres. p_hit is truncated to [0, range_max] and p_short, with its mean
    1 / lambda_short, to [0, expected], each with integral one; p_max is a mass at ``range_max``, and p_rand ends before
    it. There is no way to be too short for a ray of length zero: p_short is then zero.
    """
    error = (ranges - expected) / sigma_hit
    within = share_within(-expected / sigma_hit, (range_max - expected) / sigma_hit)
    hit = exp(-0.5 * (error * error)) / (math.sqrt(2.0 * math.pi) * sigma_hit * within)
    before = -expm1(-lambda_short * expected)
    possible = (ranges <= expected) & (before > 0.0)
    short = np.where(possible, lambda_short * exp(-lambda_short * ranges), 0.0) / np.where(possible, before, 1.0)
    at_max = ranges >= range_max
    return np.stack((hit, short, np.where(at_max, 1.0, 0.0), np.where(at_max, 0.0, 1.0 / range_max)))


def share_within(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the probability that a standard normal number lies between ``low`` <= 0 and ``high`` >= 0, both (n,)."""
    return 0.5 * (erf(high / math.sqrt(2.0)) - erf(low / math.sqrt(2.0)))
