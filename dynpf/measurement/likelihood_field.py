"""The likelihood field: a beam is as likely as its end is close to a wall (Thrun et al., 2005, section 6.4).

Nothing is cast: the distance of every cell to the nearest wall is known beforehand, and with it the logarithm of the
likelihood. Fast and smooth in the pose; blind to walls that stand between robot and end.
"""

import copy
import math
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from dynpf import kernels
from dynpf.maps.distance import distance_field
from dynpf.maps.occupancy import OccupancyGrid, faces
from dynpf.measurement.contradiction import NEAR_M, contradicted_share
from dynpf.measurement.scan import Scan
from dynpf.params import validated
from dynpf.portable import exp, hypot, log
from dynpf.se2 import compose
from dynpf.types import Count, Floats, Positive, Rate, Share

__all__ = ["LikelihoodField", "LikelihoodFieldParams"]


class BeamSkip(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Leave out beams that the particles agree not to understand: people, doors, things that were moved.

    A beam is left out when it ends farther than ``distance`` from every wall for more than 1 - ``agreement`` of the
    particles. When that would take more than ``most`` of the beams, it is the robot that is lost: none is left out.
    """

    distance: Positive = 0.5  # m
    agreement: Share = 0.3
    most: Share = 0.9


class LikelihoodFieldParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="likelihood_field"
):
    """Noise of a beam's end, and how the beams of a scan are put together."""

    sigma_hit: Positive = 0.2  # m
    z_hit: Positive = 0.95  # share of beams that end on a wall of the map
    z_rand: Positive = 0.05  # share of beams that end anywhere up to the range's maximum
    max_beams: Count = 60
    # The occupied cells that count as walls: "all", or "faces", those at the side of a free cell. Beams end on faces;
    # what is behind them only draws the robot on.
    walls: Literal["all", "faces"] = "all"
    max_distance: Positive = 2.0  # m from a wall; all that lies farther off is as likely
    # "product": the beams are independent. "cubes": 1 + sum of p^3, as in AMCL, which forgives much.
    aggregation: Literal["product", "cubes"] = "product"
    # Exponent of the product: beams of one scan share their errors, so each counts for less than if it stood alone.
    tempering: Rate = 1.0
    beam_skip: BeamSkip | None = None
    # Pose of the sensor, metres and radians, seen from where the scan says that it is on the robot.
    sensor_x: float = 0.0
    sensor_y: float = 0.0
    sensor_theta: float = 0.0


class BeamEnds(NamedTuple):
    """Where the beams of a scan end in the robot's frame, in cells, float32 (B,), and their maximum in metres."""

    x: Floats
    y: Floats
    range_max: float


class LikelihoodField:
    """The model of a scan in an occupancy grid.

    Beams without return (at the maximum range) and beams that are not numbers carry no information; a scan of no other
    beams is not admitted, and its log-likelihood is zero. Outside the grid nothing is known but the walls inside it: a
    beam that ends far out there is as likely as one far from any wall, so a particle off the map is unlikely but
    possible. One whose pose is not finite is impossible.
    """

    def __init__(self, params: LikelihoodFieldParams, grid: OccupancyGrid) -> None:
        """Compute the field; raises ValueError where a parameter is out of its range, or no cell is occupied."""
        self.params = validated(params)
        self.grid = grid
        if not grid.occupied.any():
            raise ValueError("a likelihood field needs a map with an occupied cell; this one has none")
        # A beam may end a little outside the grid and still be close to a wall: the field goes on to where none is.
        outside = math.ceil(params.max_distance / grid.resolution)
        occupied = grid.occupied if params.walls == "all" else faces(grid.occupied, grid.free)
        walls = np.pad(occupied, outside)
        self._distances = distance_field(walls, grid.resolution, params.max_distance)
        self._kept: tuple[float, Floats] | None = None
        height, width = grid.cells.shape
        self._near = self._distances[outside : outside + height, outside : outside + width] <= NEAR_M
        # The table has a border of one cell, and float32 best holds numbers that start at its corner.
        column, row = grid.to_cells(0.0, 0.0)
        self._frame = np.array(
            [-grid.origin[2], column + outside + 1.0, row + outside + 1.0, 1.0 / grid.resolution], dtype=np.float32
        )

    def smoothed(self, sigma: float) -> "LikelihoodField":
        """Return the model for poses whose error moves the ends of beams by ``sigma`` metres, of the same field."""
        made = copy.copy(self)
        made.params = msgspec.structs.replace(self.params, sigma_hit=hypot(float(self.params.sigma_hit), float(sigma)))
        made._kept = None
        return made

    def matching(self, sigma: float, beams: int, tempering: float) -> "LikelihoodField":
        """Return the model of the same field for so many beams, whose ends have the noise ``sigma`` (m)."""
        made = copy.copy(self)
        made.params = msgspec.structs.replace(
            self.params, sigma_hit=sigma, max_beams=beams, tempering=tempering, aggregation="product", beam_skip=None
        )
        made._kept = None
        return made

    def contradicted(self, reading: Scan, pose: Floats) -> float:
        """Return the share of beams that the map contradicts from a pose (3,); see contradicted_share."""
        params = self.params
        mount = reading.mounted(params.sensor_x, params.sensor_y, params.sensor_theta).astype(np.float64)
        sensor = compose(np.asarray(pose, dtype=np.float64), mount)
        return contradicted_share(self.grid, self._near, reading, sensor, params.max_beams)

    def admit(self, particles: Floats, weights: Floats, reading: Scan) -> BeamEnds | None:
        """Return where the beams that carry information end, at most ``max_beams``; None if there are none."""
        ends = self._ends(reading)
        if ends.x.size and self.params.beam_skip is not None:
            ends = self._agreed(particles, weights, ends, self.params.beam_skip)
        return ends if ends.x.size else None

    def count(self, reading: BeamEnds) -> int:
        """Return the number of beams."""
        return int(reading.x.size)

    def log_likelihood(self, particles: Floats, reading: Scan | BeamEnds) -> Floats:
        """Return log p(scan | particle), up to a constant with "cubes", shape (N,) float32."""
        ends = self._ends(reading) if isinstance(reading, Scan) else reading
        if not ends.x.size:
            return np.zeros(particles.shape[1], dtype=np.float32)
        total = self._sum(particles, ends, self._table(ends.range_max))
        if self.params.aggregation == "cubes":
            kernels.likelihood_field.log_of_one_more(total)
            return total
        if self.params.tempering != 1.0:
            total *= np.float32(self.params.tempering)
        return total

    def _ends(self, scan: Scan) -> BeamEnds:
        params = self.params
        mount = scan.mounted(params.sensor_x, params.sensor_y, params.sensor_theta)
        x, y = np.empty((2, params.max_beams), dtype=np.float32)
        count = kernels.likelihood_field.find_beam_ends(
            *scan.beams(), float(scan.range_min), float(scan.range_max), mount, 1.0 / self.grid.resolution, x, y
        )
        return BeamEnds(x[:count], y[:count], scan.range_max)

    def _agreed(self, particles: Floats, weights: Floats, ends: BeamEnds, skip: BeamSkip) -> BeamEnds:
        near = np.zeros(self._padded_shape, dtype=np.float32)
        near[1:-1, 1:-1] = self._distances <= skip.distance
        share = np.empty(ends.x.size)
        for beam in range(ends.x.size):
            alone = BeamEnds(ends.x[beam : beam + 1], ends.y[beam : beam + 1], ends.range_max)
            share[beam] = np.sum(weights * self._sum(particles, alone, near), dtype=np.float64)
        kept = share >= skip.agreement
        if np.count_nonzero(~kept) > skip.most * kept.size:
            return ends
        return BeamEnds(ends.x[kept], ends.y[kept], ends.range_max)

    def _sum(self, particles: Floats, ends: BeamEnds, table: Floats) -> Floats:
        x, y, theta = particles[:3].astype(np.float32, copy=False)
        total = np.empty(x.size, dtype=np.float32)
        kernels.likelihood_field.sum_over_beams(x, y, theta, ends.x, ends.y, table, self._frame, total)
        return total

    @property
    def _padded_shape(self) -> tuple[int, int]:
        return self._distances.shape[0] + 2, self._distances.shape[1] + 2

    def _table(self, range_max: float) -> Floats:
        """Return what each cell adds to the sum for a beam that ends there, with a border for the world outside."""
        if self._kept is None or self._kept[0] != range_max:
            params = self.params
            peak = params.z_hit / (math.sqrt(2.0 * math.pi) * params.sigma_hit)
            distances = np.full(self._padded_shape, np.inf)
            distances[1:-1, 1:-1] = self._distances
            likelihood = peak * exp(-0.5 * np.square(distances / params.sigma_hit)) + params.z_rand / range_max
            cell = log(likelihood) if params.aggregation == "product" else likelihood * likelihood * likelihood
            self._kept = (range_max, cell.astype(np.float32))
        return self._kept[1]
