"""Search of a whole map for the poses that explain the readings: coarsely at first, then ever finer where it pays.

The belief of a filter that knows nothing is a histogram over the map. Its cells are small where the likelihood is
large: those that explain the readings best are cut in eight, and again. A coarse cell is compared by a model whose
noise is as wide as the cell, so that it stands for all poses in it.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.filters.cloud import gathered, normalized_weights
from dynpf.filters.models import Evidence, Models
from dynpf.filters.resampling import systematic
from dynpf.maps.occupancy import FREE, OccupancyGrid
from dynpf.measurement.model import MeasurementModel
from dynpf.params import validated
from dynpf.portable import hypot, log, sincos, whole
from dynpf.rng import Stream
from dynpf.se2 import wrap_angle
from dynpf.types import Count, Floats, Positive

__all__ = ["Contradictable", "Places", "Search", "SearchStart", "Smoothable"]


FREE_SHARE = 0.25
"""Of a coarse cell, that must be free for a robot to be looked for there."""

MOST_CELLS = 20_000_000

NEAR_LEVEL, NEAR_KEPT = 1, 300
"""Around a pose, which cells are the coarsest, and how many of them are cut in eight."""


class SearchStart(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="search"
):
    """How finely the free space of the map is searched for poses that explain the readings."""

    spacing: Positive = 0.25  # m, side of the coarsest cells
    # m, to what is seen, about: a coarse cell's turn moves that by ``spacing``.
    lever: Positive = 4.0
    halvings: Annotated[int, Meta(ge=0, le=8)] = 3  # of the sides of cells, which end at spacing / 2^halvings
    kept: Count = 10_000  # cells that are cut in eight at each halving


@runtime_checkable
class Smoothable(Protocol):
    """A measurement model that can also tell how likely a reading is for a pose that is not known exactly."""

    def smoothed(self, sigma: float) -> MeasurementModel[Any]:
        """Return the model for poses whose error moves what is seen by ``sigma`` metres."""


@runtime_checkable
class Contradictable(Protocol):
    """A measurement model of readings that a map can contradict, not only leave unexplained."""

    def contradicted(self, reading: Any, pose: Floats) -> float:
        """Return the share of a reading that the map contradicts from a pose (3,)."""


class Places(NamedTuple):
    """Small cells all over the map of which some explain the readings; ``weights`` (M,) float32 sum to one."""

    poses: Floats  # of their centres, (3, M)
    weights: Floats
    sides: tuple[float, float]  # m, rad
    log_evidence: float  # log of the readings' mean likelihood over all of the map's free space
    log_likelihood: float  # of the best cell
    scores: Floats | None = None  # log-likelihoods of the cells (M,)

    @property
    def best(self) -> Floats:
        """The pose (3,) of the likeliest cell, the first of equal ones."""
        return self.poses[:, int(np.argmax(self.weights))]

    def distinct(self, most: int, apart_m: float, apart_rad: float) -> list[tuple[Floats, float]]:
        """Return at most so many poses (3,), the likeliest first, with log-likelihoods: no two of the same place."""
        assert self.scores is not None
        left = self.scores.astype(np.float64)
        found: list[tuple[Floats, float]] = []
        while len(found) < most and left.size and (index := int(np.argmax(left))) >= 0 and np.isfinite(left[index]):
            pose = self.poses[:, index]
            found.append((pose, float(left[index])))
            turn = np.abs(wrap_angle(self.poses[2] - pose[2]))
            near = (hypot(self.poses[0] - pose[0], self.poses[1] - pose[1]) <= apart_m) & (turn <= apart_rad)
            left[near] = -np.inf
        return found

    def draw(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:  # noqa: ARG002
        """Return poses (3, count) float32, spread over the cells by their weights: see PoseSource."""
        poses = gathered(self.poses, systematic(self.weights, stream.part("comb").uniform(), count))
        offsets = stream.part("within").uniforms(3, count) - np.float32(0.5)
        side, turn = self.sides
        poses += offsets * np.array([[side], [side], [turn]], dtype=np.float32)
        poses[2] = wrap_angle(poses[2])
        return poses


class Search:
    """Where in the free space of a map readings could have been taken.

    Only readings whose model is Smoothable tell where; where there is none, all of the free space is as likely. Work
    and memory grow with the free area: of 100 m^2 about 170,000 coarse cells, and a microsecond for 10 of a scan's
    beams.
    """

    def __init__(self, params: SearchStart, models: Models, grid: OccupancyGrid) -> None:
        """Lay out the coarse cells.

        Raises ValueError when no model is Smoothable, no cell free, or the coarse cells are too many to go over.
        """
        self.params = validated(params)
        self.grid = grid
        able = {taken: model for taken, model in models.measurements.items() if isinstance(model, Smoothable)}
        if not able:
            raise ValueError("a search needs a measurement model that can be smoothed, such as likelihood_field")
        cells = max(round(params.spacing / grid.resolution), 1)
        turns = max(round(2.0 * math.pi * params.lever / params.spacing), 1)
        self._side, self._turn = cells * grid.resolution, 2.0 * math.pi / turns
        x, y = self._free(cells)
        if not x.size:
            raise ValueError("a search needs a map with free space; this one has none")
        if x.size * turns > MOST_CELLS:
            raise ValueError(
                f"spacing = {params.spacing}: a search over {x.size} x {turns} cells; expected at most {MOST_CELLS}"
            )
        headings = np.arange(turns) * self._turn - math.pi
        self._coarse = np.stack([np.tile(x, turns), np.tile(y, turns), np.repeat(headings, x.size)]).astype(np.float32)
        self._levels = []
        for level in range(params.halvings + 1):
            side, lever = self._side / (1 << level), params.lever * self._turn / (1 << level)
            # Along any direction: of a square's position by one coordinate, and of a turn at the lever's end.
            sigma = hypot(side, lever) / math.sqrt(12.0)
            smoothed = {taken: model.smoothed(sigma) for taken, model in able.items()}
            self._levels.append(Models(models.motion, smoothed, models.threads))

    def draw(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:
        """Return poses (3, count) float32 from which the readings are likely: see PoseSource."""
        return self.places(readings).draw(count, readings, stream)

    def places(self, readings: Sequence[Any]) -> Places:
        """Return the cells that explain the readings, and how likely the readings are anywhere."""
        poses, scores = self._coarse, self._scores(0, self._coarse, readings)
        for level in range(self.params.halvings):
            poses = self._halved(_best(poses, scores, self.params.kept), level)
            scores = self._scores(level + 1, poses, readings)
        scores[~self._is_free(poses)] = -np.inf
        weights, log_sum = normalized_weights(scores)
        scale = 1 << self.params.halvings
        cells = float(self._coarse.shape[1] * scale * scale * scale)
        best = float(np.max(scores))
        return Places(poses, weights, (self._side / scale, self._turn / scale), log_sum - log(cells), best, scores)

    def near(self, pose: Floats, readings: Sequence[Any], reach_m: float, reach_rad: float) -> Places:
        """Return the cells around a pose (3,) that explain the readings, free or not.

        Weights are by the likelihood and a Gaussian about the pose, of half the reach as standard deviation. The sides
        are those of the coarsest cells: draws are to be compared with the readings again.
        """
        level = min(NEAR_LEVEL, self.params.halvings)
        side, turn = self._side / (1 << level), self._turn / (1 << level)
        along, around = (math.ceil(reach / size) for reach, size in ((reach_m, side), (reach_rad, turn)))
        steps = np.arange(-along, along + 1) * side
        dx, dy, dturn = np.meshgrid(steps, steps, np.arange(-around, around + 1) * turn, indexing="ij")
        x, y, theta = (float(number) for number in pose)
        poses = np.stack([x + dx.ravel(), y + dy.ravel(), theta + dturn.ravel()]).astype(np.float32)
        cells, scores = poses.shape[1], self._scores(level, poses, readings)
        for finer in range(level, self.params.halvings):
            poses = self._halved(_best(poses, scores, NEAR_KEPT), finer)
            scores = self._scores(finer + 1, poses, readings)
        away = (hypot(poses[0] - x, poses[1] - y) / reach_m, wrap_angle(poses[2] - theta) / reach_rad)
        prior = -2.0 * (np.square(away[0]) + np.square(away[1]))
        weights, log_sum = normalized_weights((scores + prior).astype(np.float32))
        parts = 1 << (self.params.halvings - level)
        evidence = log_sum - log(float(cells * parts * parts * parts))
        return Places(poses, weights, (side, turn), evidence, float(np.max(scores)), scores)

    def contradicted(self, pose: Floats, readings: Sequence[Any]) -> float:
        """Return the share of the readings that the map contradicts from a pose (3,); 1 if no model can tell."""
        models = self._levels[-1].measurements
        able = [(models[type(reading)], reading) for reading in readings if type(reading) in models]
        shares = [model.contradicted(reading, pose) for model, reading in able if isinstance(model, Contradictable)]
        return max(shares, default=1.0)

    def _free(self, cells: int) -> tuple[Floats, Floats]:
        """Return the centres in the map's frame of blocks of so many cells a side that are free enough."""
        height, width = self.grid.cells.shape
        free = np.pad(self.grid.free, ((0, -height % cells), (0, -width % cells)))
        blocks = free.reshape(free.shape[0] // cells, cells, -1, cells)
        row, column = np.nonzero(blocks.mean(axis=(1, 3)) >= FREE_SHARE)
        return self._turned((column + 0.5) * self._side, (row + 0.5) * self._side, *self.grid.origin[:2])

    def _turned(self, along: Floats, across: Floats, x: float, y: float) -> tuple[Floats, Floats]:
        sine, cosine = sincos(float(self.grid.origin[2]))
        return x + cosine * along - sine * across, y + sine * along + cosine * across

    def _halved(self, poses: Floats, level: int) -> Floats:
        """Return the eight parts of each cell."""
        side, turn = (full / (4 << level) for full in (self._side, self._turn))
        parts = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=np.float64).T
        dx, dy = self._turned(parts[0] * side, parts[1] * side, 0.0, 0.0)
        offsets = np.stack([dx, dy, parts[2] * turn]).astype(np.float32)
        return np.ascontiguousarray((offsets[:, :, None] + poses[:, None, :]).reshape(3, -1))

    def _scores(self, level: int, poses: Floats, readings: Sequence[Any]) -> Floats:
        models = self._levels[level]
        evidence = [
            Evidence(models.measurements[type(reading)], reading, 1)
            for reading in readings
            if type(reading) in models.measurements
        ]
        if not evidence:
            return np.zeros(poses.shape[1], dtype=np.float32)
        return np.array(models.log_likelihood(poses, evidence), dtype=np.float32)

    def _is_free(self, poses: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        column, row = self.grid.to_cells(poses[0], poses[1])
        height, width = self.grid.cells.shape
        # Comparisons come before anything is made an integer.
        inside = (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
        free = np.zeros(poses.shape[1], dtype=bool)
        cells = whole(row[inside], 0, height - 1), whole(column[inside], 0, width - 1)
        free[inside] = self.grid.cells[cells] == FREE
        return free


def _best(poses: Floats, scores: Floats, count: int) -> Floats:
    """Return the poses of the ``count`` best scores, in their order; of equal ones the first."""
    if scores.size <= count:
        return poses
    least = np.partition(scores, scores.size - count)[scores.size - count]
    better, equal = scores > least, np.flatnonzero(scores == least)
    better[equal[: count - np.count_nonzero(better)]] = True
    return poses[:, better]
