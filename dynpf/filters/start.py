"""Where particles come from: a known pose, anywhere on the map, or wherever the readings would be likely."""

import math
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf.filters.adaptation import PoseSource
from dynpf.filters.cloud import gathered, normalized_weights
from dynpf.filters.kalman import symmetric_offsets
from dynpf.filters.models import Models
from dynpf.filters.resampling import systematic
from dynpf.filters.search import Search, SearchStart
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.se2 import is_far
from dynpf.types import Count, FloatArray, Floats, NonNegative

__all__ = [
    "Box",
    "FromReadings",
    "FromReadingsStart",
    "KnownStart",
    "Start",
    "Uniform",
    "UniformStart",
    "around",
    "drawn",
    "pose_source",
    "start_poses",
]


class KnownStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="known"):
    """A pose known up to Gaussian errors of the given standard deviations; metres and radians."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    sigma_position: NonNegative = 0.05
    sigma_heading: NonNegative = 0.05


class Box(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A rectangle along the axes of the map frame, metres."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    def __post_init__(self) -> None:
        if not (self.x_min <= self.x_max and self.y_min <= self.y_max):
            raise ValueError(f"x {self.x_min} to {self.x_max}, y {self.y_min} to {self.y_max}: a minimum is the larger")


class UniformStart(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="uniform"
):
    """Any position in a box, or else in the free space of the map; any heading, unless one is given."""

    box: Box | None = None
    clearance: NonNegative = 0.0  # m that free space keeps from walls
    theta: float | None = None  # rad


class FromReadingsStart(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="from_readings"
):
    """Poses from which the first readings are likely, chosen among candidates."""

    candidates: Count = 10  # to each pose that is wanted
    base: UniformStart = UniformStart()


Start = KnownStart | UniformStart | FromReadingsStart | SearchStart


@runtime_checkable
class SamplesPoses(Protocol):
    """A measurement model that knows from where a reading could have been taken."""

    def poses(self, reading: Any, count: int, stream: Stream) -> Floats:
        """Return poses (3, count) float32 from which the reading is likely."""


class Uniform:
    """Poses spread evenly, whatever the readings are."""

    def __init__(self, params: UniformStart, grid: OccupancyGrid | None = None) -> None:
        """Raises ValueError when there is neither a box nor a grid to draw from."""
        self.params = validated(params)
        self.grid = grid
        if params.box is None and grid is None:
            raise ValueError("a uniform start needs a box (x_min, x_max, y_min, y_max) or a grid map: there is neither")

    def draw(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:  # noqa: ARG002
        """See PoseSource."""
        poses = self._anywhere(count, stream)
        if self.params.theta is not None:
            poses[2] = self.params.theta
        return poses

    def within(self, poses: Floats) -> NDArray[np.bool_]:
        """Return which of the poses (3, N) lie in the box, (N,); without a box all of them."""
        box = self.params.box
        if box is None:
            return np.ones(poses.shape[1], dtype=np.bool_)
        x, y = poses[:2]
        inside: NDArray[np.bool_] = (box.x_min <= x) & (x <= box.x_max) & (box.y_min <= y) & (y <= box.y_max)
        return inside

    def _anywhere(self, count: int, stream: Stream) -> Floats:
        box = self.params.box
        if box is not None:
            low = np.array([[box.x_min], [box.y_min], [-math.pi]])
            high = np.array([[box.x_max], [box.y_max], [math.pi]])
            poses: Floats = (low + (high - low) * stream.uniforms(3, count)).astype(np.float32)
            return poses
        assert self.grid is not None
        return self.grid.sample_free(count, stream, self.params.clearance)


class FromReadings:
    """Poses in proportion to the likelihood of the readings of the moment, chosen among many candidates.

    Candidates come from the first reading whose model can tell where it may have been taken (``poses``), else from the
    base; a box of the base bounds both. A systematic comb through their likelihoods leaves the poses: likely ones
    several times, so that a filter must move or spread them. Candidates that a reading has proposed are weighed by it
    once more, which draws them closer to it than its noise would. Where no reading carries information, or no candidate
    explains them, the candidates are chosen evenly.
    """

    def __init__(self, params: FromReadingsStart, models: Models, base: Uniform) -> None:
        self.params = validated(params)
        self.models = models
        self.base = base

    def draw(self, count: int, readings: Sequence[Any], stream: Stream) -> Floats:
        """See PoseSource. Raises TypeError for a reading that no measurement model takes."""
        total = count * self.params.candidates
        candidates = self.base.draw(total, readings, stream.part("base"))
        equal = np.full(total, 1.0 / total, dtype=np.float32)
        evidence, _ = self.models.believable(candidates, equal, readings)
        if not evidence:
            return np.ascontiguousarray(candidates[:, :: self.params.candidates])
        for model, reading, _ in evidence:
            if isinstance(model, SamplesPoses):
                candidates = model.poses(reading, total, stream.part("poses"))
                break
        likelihood = self.models.log_likelihood(candidates, evidence)
        weights, _ = normalized_weights(np.where(self.base.within(candidates), likelihood, np.float32(-np.inf)))
        return gathered(candidates, systematic(weights, stream.part("comb").uniform(), count))


def pose_source(
    start: UniformStart | FromReadingsStart | SearchStart,
    *,
    grid: OccupancyGrid | None = None,
    models: Models | None = None,
) -> PoseSource:
    """Return where a filter may begin, or begin again, without knowing its pose.

    Raises ValueError when there is neither box nor grid, or no models to weigh readings by, and as Search does.
    """
    if isinstance(start, UniformStart):
        return Uniform(start, grid)
    if models is None:
        raise ValueError("a start from readings needs the models that weigh them: there are none")
    if isinstance(start, SearchStart):
        if grid is None:
            raise ValueError("a search needs a grid map to go over: there is none")
        return Search(start, models, grid)
    return FromReadings(start, models, Uniform(start.base, grid))


def start_poses(
    start: Start,
    count: int,
    stream: Stream,
    *,
    grid: OccupancyGrid | None = None,
    models: Models | None = None,
    readings: Sequence[Any] = (),
) -> Floats:
    """Return the poses that ``count`` particles begin at, shape (3, count) float32; raises what ``pose_source`` does.

    The grid is for a uniform start without a box; models and readings are for a start from readings.
    """
    if isinstance(start, KnownStart):
        return around(start, count, stream)
    return pose_source(start, grid=grid, models=models).draw(count, readings, stream)


def around(start: KnownStart, count: int, stream: Stream) -> Floats:
    """Return ``count`` poses drawn around a known one, shape (3, count) float32; float64 where that is too coarse.

    Raises ValueError where a parameter is out of its range.
    """
    validated(start)
    mean = np.array([start.x, start.y, start.theta])
    sigma = np.array([start.sigma_position, start.sigma_position, start.sigma_heading])
    poses: Floats = mean[:, None] + sigma[:, None] * stream.normals(3, count)
    return poses if is_far(poses) else poses.astype(np.float32)


def drawn(mean: FloatArray, covariance: FloatArray, count: int, stream: Stream) -> Floats:
    """Return ``count`` poses, shape (3, count), of a Gaussian with mean (3,) and covariance (3, 3).

    They are float32 unless that is too coarse there. Raises ValueError for a covariance with a negative eigenvalue.
    """
    poses: Floats = mean[:, None]
    for column, normal in zip(symmetric_offsets(covariance, 1.0).T[:3], stream.normals(3, count), strict=True):
        poses = poses + column[:, None] * normal
    return poses if is_far(poses) else poses.astype(np.float32)
