"""The baseline: the same updates in plain NumPy, in float32, without compiled code.

It uses a precomputed log-likelihood map, one sine and cosine for each particle, all particles and beams in a single
expression, and resampling in linear time.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.types import Float32s

__all__ = ["Beams", "Field", "Landmarks", "Rays", "Updated", "adapted", "distances", "moved", "update"]

BLOCK = 65_536  # particles at once: more would not fit into memory

Weigh = Callable[[Float32s], Float32s]


class Updated(NamedTuple):
    """Particles (3, N) after resampling; estimate (3,) and effective sample size from before it."""

    particles: Float32s
    estimate: NDArray[np.float64]
    n_eff: float


def update(
    particles: Float32s,
    made: tuple[float, float, float],
    sigma: tuple[float, float, float],
    log_likelihood: Weigh,
    rng: np.random.Generator,
) -> Updated:
    """Return particles (3, N) moved, weighted and resampled systematically, with the estimate."""
    poses = moved(particles, made, sigma, rng)
    weights = normalized(log_likelihood(poses))
    return Updated(poses[:, systematic(weights, rng)], mean(poses, weights), 1.0 / float(np.sum(weights * weights)))


def moved(
    particles: Float32s, made: tuple[float, float, float], sigma: tuple[float, float, float], rng: np.random.Generator
) -> Float32s:
    """Return particles (3, N) after a noisy rotation, translation and rotation."""
    noise = rng.standard_normal((3, particles.shape[1]), dtype=np.float32)
    first, way, second = (np.float32(m) + np.float32(s) * row for m, s, row in zip(made, sigma, noise, strict=True))
    direction = particles[2] + first
    return np.stack(
        (particles[0] + way * np.cos(direction), particles[1] + way * np.sin(direction), wrapped(direction + second))
    )


def wrapped(angle: Float32s) -> Float32s:
    """Return angles wrapped to [-pi, pi]."""
    turns: Float32s = np.rint(angle * np.float32(0.5 / np.pi))
    return angle - np.float32(2.0 * np.pi) * turns


def normalized(log_weights: Float32s) -> Float32s:
    """Return weights that sum to one."""
    weights: Float32s = np.exp(log_weights - np.max(log_weights))
    weights /= np.sum(weights)
    return weights


def mean(poses: Float32s, weights: Float32s) -> NDArray[np.float64]:
    """Return the weighted mean pose, with the circular mean of the heading."""
    x, y, cosine, sine = (
        np.sum(weights * row, dtype=np.float64) for row in (poses[0], poses[1], np.cos(poses[2]), np.sin(poses[2]))
    )
    return np.array([x, y, np.arctan2(sine, cosine)])


def systematic(weights: Float32s, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return the indices of systematic resampling with N equal spacings, by counting them below each partial sum."""
    n = len(weights)
    below = np.ceil(np.cumsum(weights, dtype=np.float64) * n - rng.random())
    below[-1] = n
    return np.repeat(np.arange(n), np.diff(below, prepend=0.0).astype(np.int64))


class Landmarks:
    """Range and bearing to landmarks (L, 2) with independent Gaussian errors."""

    def __init__(self, landmarks: NDArray[np.float64], sigma_range: float, sigma_bearing: float) -> None:
        self.x, self.y = landmarks.T.astype(np.float32)[:, :, None]
        self.scale_range, self.scale_bearing = np.float32(1.0 / sigma_range), np.float32(1.0 / sigma_bearing)

    def log_likelihood(self, poses: Float32s, ranges: NDArray[np.float64], bearings: NDArray[np.float64]) -> Float32s:
        """Return the log-density up to a constant, shape (N,), of ranges and bearings (L,)."""
        seen_range, seen_bearing = ranges.astype(np.float32)[:, None], bearings.astype(np.float32)[:, None]
        score = np.empty(poses.shape[1], dtype=np.float32)
        for start in range(0, len(score), BLOCK):
            x, y, heading = poses[:, start : start + BLOCK]
            east, north = self.x - x, self.y - y
            across = (seen_range - np.sqrt(east * east + north * north)) * self.scale_range
            turned = wrapped(seen_bearing - (np.arctan2(north, east) - heading)) * self.scale_bearing
            score[start : start + BLOCK] = np.float32(-0.5) * np.sum(across * across + turned * turned, axis=0)
        return score


class Field:
    """Likelihood field: each beam scores by the distance from its end to the nearest wall.

    log(z_hit N(distance; 0, sigma_hit) + z_rand / range_max), tabulated, as far outside the map as walls reach.
    """

    def __init__(
        self, grid: OccupancyGrid, *, z_hit: float, z_rand: float, sigma_hit: float, range_max: float, farthest: float
    ) -> None:
        self.grid, self.range_max = grid, range_max
        self.margin = math.ceil(farthest / grid.resolution)
        walls = np.pad(grid.occupied, self.margin)
        gaps = np.minimum(distances(walls) * grid.resolution, farthest)
        peak = z_hit / (sigma_hit * np.sqrt(2.0 * np.pi))
        table = np.log(peak * np.exp(-0.5 * (gaps / sigma_hit) ** 2) + z_rand / range_max)
        # One more cell on each side stands for everything farther outside.
        outside = np.log(peak * np.exp(-0.5 * (farthest / sigma_hit) ** 2) + z_rand / range_max)
        self.table = np.pad(table, 1, constant_values=outside).astype(np.float32)

    def log_likelihood(self, poses: Float32s, angles: Float32s, ranges: Float32s) -> Float32s:
        """Return the sum over the beams that returned, shape (N,), of angles and ranges (B,)."""
        returned = ranges < self.range_max
        cell = np.float32(1.0 / self.grid.resolution)
        ahead = (ranges[returned] * np.cos(angles[returned]) * cell)[:, None]
        aside = (ranges[returned] * np.sin(angles[returned]) * cell)[:, None]
        height, width = self.table.shape
        flat, corner = self.table.ravel(), np.float32(self.margin + 1)
        score = np.empty(poses.shape[1], dtype=np.float32)
        for start in range(0, len(score), BLOCK):
            column, row, heading = in_cells(self.grid, poses[:, start : start + BLOCK])
            cosine, sine = np.cos(heading), np.sin(heading)
            across = np.clip(column + corner + cosine * ahead - sine * aside, 0.0, width - 1).astype(np.int32)
            along = np.clip(row + corner + sine * ahead + cosine * aside, 0.0, height - 1).astype(np.int32)
            score[start : start + BLOCK] = np.sum(flat[along * np.int32(width) + across], axis=0)
        return score


class Rays:
    """Ranges by marching: each step is the distance to the nearest wall, at least half a cell."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        # The cell's centre may be half a diagonal nearer than where the ray is, and so may the wall's.
        self.stride = np.maximum(distances(grid.occupied) - np.sqrt(2.0), 0.5).astype(np.float32)
        self.wall = grid.occupied

    def ranges(self, x: Float32s, y: Float32s, angles: Float32s, range_max: float) -> Float32s:
        """Return the distance to the first wall along each of N rays, at most ``range_max``, to half a cell."""
        column, row, direction = in_cells(self.grid, np.stack((x, y, angles)))
        east, north = np.cos(direction), np.sin(direction)
        reach = np.float32(range_max / self.grid.resolution)
        found = np.full(len(column), reach, dtype=np.float32)
        going, gone = np.arange(len(column)), np.zeros(len(column), dtype=np.float32)
        height, width = self.wall.shape
        while len(going):
            c, r = np.floor(column).astype(np.int32), np.floor(row).astype(np.int32)
            inside = (c >= 0) & (c < width) & (r >= 0) & (r < height)
            c, r = np.where(inside, c, 0), np.where(inside, r, 0)
            hit = inside & self.wall[r, c]
            found[going[hit]] = gone[hit]
            stride = self.stride[r, c]
            gone = gone + stride
            on = inside & ~hit & (gone < reach)
            stride, gone, going, east, north = stride[on], gone[on], going[on], east[on], north[on]
            column, row = column[on] + stride * east, row[on] + stride * north
        return found * np.float32(self.grid.resolution)

    def scans(self, poses: Float32s, angles: Float32s, range_max: float) -> Float32s:
        """Return the ranges of beams at ``angles`` (B,) from each of the poses (3, N), shape (N, B)."""
        x, y, heading = poses[:, :, None]
        x, y, directions = np.broadcast_arrays(x, y, heading + angles)
        return self.ranges(x.ravel(), y.ravel(), directions.ravel(), range_max).reshape(directions.shape)


class Beams:
    """Beam model: a Gaussian around the map's range, an exponential before it, a share at the end and a uniform share.

    The Gaussian is not truncated at the ends of the scale, which would cost more and matters only there.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        shares: tuple[float, float, float, float],
        sigma_hit: float,
        rate_short: float,
        range_max: float,
    ) -> None:
        self.rays = Rays(grid)
        self.shares = tuple(np.float32(share) for share in shares)  # hit, short, max, rand
        self.sigma_hit, self.rate_short, self.range_max = sigma_hit, rate_short, range_max

    def log_likelihood(self, poses: Float32s, angles: Float32s, ranges: Float32s) -> Float32s:
        """Return the sum of log p(range | pose) over the beams, shape (N,), of angles and ranges (B,)."""
        score = np.empty(poses.shape[1], dtype=np.float32)
        for start in range(0, len(score), BLOCK):
            expected = self.rays.scans(poses[:, start : start + BLOCK], angles, self.range_max)
            score[start : start + BLOCK] = np.sum(np.log(self.density(ranges, expected)), axis=1)
        return score

    def density(self, ranges: Float32s, expected: Float32s) -> Float32s:
        """Return p(range | expected range) of ranges (B,) where each of N particles expects (N, B)."""
        hit, short, farthest, anywhere = self.shares
        off = (ranges - expected) * np.float32(1.0 / self.sigma_hit)
        density = hit * np.float32(1.0 / (self.sigma_hit * np.sqrt(2.0 * np.pi))) * np.exp(np.float32(-0.5) * off * off)
        rate = np.float32(self.rate_short)
        possible = np.maximum(-np.expm1(-rate * expected), np.float32(1e-3))
        before = rate * np.exp(-rate * ranges) / possible
        density += short * np.where(ranges <= expected, before, np.float32(0.0))
        density += np.where(ranges >= self.range_max, farthest, anywhere * np.float32(1.0 / self.range_max))
        return density


def adapted(
    poses: Float32s, weights: Float32s, n_max: int, rng: np.random.Generator, *, bins: tuple[float, float], error: float
) -> Float32s:
    """Return poses drawn one by one until KLD-sampling (Fox, 2003) has enough of them, at most ``n_max``.

    ``bins`` are their sides in metres and radians; the quantile is that of 99 %. Draws come in lots that double.
    """
    partial = np.cumsum(weights, dtype=np.float64)
    drawn = np.empty(0, dtype=np.int64)
    while True:
        lot = min(max(len(drawn), 256), n_max - len(drawn))
        drawn = np.concatenate((drawn, np.searchsorted(partial[:-1], rng.random(lot) * partial[-1])))
        keys = np.floor(poses[:, drawn].T / np.array((bins[0], bins[0], bins[1]), dtype=np.float32)).astype(np.int64)
        packed = (keys[:, 0] * 2**21 + keys[:, 1]) * 2**21 + keys[:, 2]
        first_met = np.zeros(len(drawn), dtype=np.int64)
        first_met[np.unique(packed, return_index=True)[1]] = 1
        enough = np.flatnonzero(np.arange(1, len(drawn) + 1) >= _needed(np.cumsum(first_met), error))
        if len(enough) or len(drawn) >= n_max:
            return poses[:, drawn[: enough[0] + 1 if len(enough) else n_max]]


def _needed(bins: NDArray[np.int64], error: float) -> NDArray[np.float64]:
    more = np.maximum(bins - 1, 1).astype(np.float64)
    ninth = 2.0 / (9.0 * more)
    needed: NDArray[np.float64] = more / (2.0 * error) * (1.0 - ninth + np.sqrt(ninth) * 2.3263) ** 3
    return needed


def distances(occupied: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return each cell's distance to the nearest occupied one, centre to centre, in cells, shape (H, W)."""
    free = np.asarray(~occupied, dtype=np.uint8)
    return np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), dtype=np.float32)


def in_cells(grid: OccupancyGrid, poses: Float32s) -> Float32s:
    """Return poses (3, N) in the grid's frame, metres as cells."""
    x, y, yaw = (np.float32(value) for value in grid.origin)
    cell = np.float32(1.0 / grid.resolution)
    east, north = (poses[0] - x) * cell, (poses[1] - y) * cell
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.stack((cosine * east + sine * north, cosine * north - sine * east, poses[2] - yaw))
