"""The filters for a capsule as the estimator uses them: the belief is passed in and returned, and can be kept."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from dynpf_protocol.errors import ScenarioError

from dynpf.colon.classic import Classic
from dynpf.colon.end_radius import EndRadius
from dynpf.colon.hypotheses import UNLISTED, Belief, Finding, Hypotheses
from dynpf.filters.cloud import Cloud
from dynpf.filters.estimate import pose_estimate
from dynpf.filters.resampling import Indices
from dynpf.filters.start import Uniform, UniformStart
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.motion.capsule import CapsuleMotion
from dynpf.portable import hypot
from dynpf.rng import Stream
from dynpf.types import FloatArray, Floats
from dynpf_systems.colon.config import CapsuleEstimatorConfig, ClassicFilter, EndRadiusFilter, HypothesesFilter
from dynpf_systems.colon.tube import ColonWorld

__all__ = ["CapsuleFilter", "Located", "capsule_filter"]


class Moved(NamedTuple):
    """Points (2, M) on the wall of a reference map, px, and their outward displacements (M,), px."""

    reference: str
    points: FloatArray
    distances: FloatArray
    outwards: FloatArray  # (2, M), unit vectors


class Radius(NamedTuple):
    """Mean and standard deviation in px."""

    mean: float
    sigma: float


class Located(NamedTuple):
    """The estimate: pose (3,), covariance (3, 3), the map that holds, and what else the filter estimates."""

    pose: FloatArray
    covariance: FloatArray
    map: str
    maps: Mapping[str, float] = {}
    changed_at: float | None = None
    moved: Moved | None = None
    radius: Radius | None = None


class CapsuleFilter(Protocol):
    """A filter over the pose of a capsule; ``belief`` is what ``start`` or the last update returned."""

    @property
    def grids(self) -> Mapping[str, OccupancyGrid]:
        """The maps that may hold, by name."""

    def start(self, known: bool, stream: Stream) -> Any:
        """Return the initial belief: at the route's start, or uniform in the first map."""

    def update(
        self, belief: Any, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, readings: tuple[int, int]
    ) -> tuple[Any, Located]:
        """Return belief and estimate after a motion and the ranges at its end.

        ``readings`` are the numbers of the previous reading and of this one.
        """

    def cloud(self, belief: Any) -> Cloud:
        """Return the particles."""

    def freeze(self, belief: Any) -> Mapping[str, Any]:
        """Return the belief as plain state."""

    def thaw(self, state: Mapping[str, Any]) -> Any:
        """Return the belief from the state that freeze returned."""


def capsule_filter(config: CapsuleEstimatorConfig, world: ColonWorld, key: str) -> CapsuleFilter:
    """Return the filter that a scenario names at ``key``; raises ScenarioError where it does not fit the run."""
    match config.filter:
        case ClassicFilter() as table:
            return _Classic(table, world)
        case EndRadiusFilter() as table:
            return _EndRadius(table, world, f"{key}.filter")
        case HypothesesFilter() as table:
            return _Hypotheses(table, world, f"{key}.filter")


class _Classic:
    """COLON's own filter, in the map given by the schedule."""

    def __init__(self, table: ClassicFilter, world: ColonWorld) -> None:
        self.grids = {name: world.grid(name, "colon.told") for _, name in world.told.entries}
        self._filter = Classic(self.grids)
        self._table, self._world = table, world

    def start(self, known: bool, stream: Stream) -> Cloud:
        """See CapsuleFilter."""
        poses = _start_poses(self._world, self.grids[self._world.told.at(0)], self._table.n, known, stream)
        return self._filter.start(poses, stream.part("cloud"))

    def update(
        self, belief: Cloud, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, readings: tuple[int, int]
    ) -> tuple[Cloud, Located]:
        """See CapsuleFilter."""
        scheduled = self._world.told.at(readings[1])
        cloud, finding = self._filter.update(belief, motion, ranges, stream, scheduled)
        return cloud, Located(finding.pose, pose_estimate(cloud.particles, cloud.weights).covariance, scheduled)

    def cloud(self, belief: Cloud) -> Cloud:
        """See CapsuleFilter."""
        return belief

    def freeze(self, belief: Cloud) -> Mapping[str, Any]:
        """See CapsuleFilter."""
        return belief._asdict()

    def thaw(self, state: Mapping[str, Any]) -> Cloud:
        """See CapsuleFilter."""
        return _thawed(state)


class _Hypotheses:
    """The filter that estimates the map; it ignores the schedule, uses it as a hint, or obeys it."""

    def __init__(self, table: HypothesesFilter, world: ColonWorld, key: str) -> None:
        self.grids = {name: world.grid(name, f"{key}.maps") for name in table.maps}
        self._schedule, self._world = table.schedule, world
        self._filter = Hypotheses(table.obedient() if table.schedule == "obeyed" else table, self.grids)
        for _, name in world.told.entries if table.schedule != "ignored" else ():
            if name not in table.maps:
                raise ScenarioError(f"colon.told: map {name!r} is none of {key}.maps")
        self._nodes = {
            name: _nodes(grid, wall.places, wall.following)
            for name, grid, wall in zip(table.maps, self.grids.values(), self._filter.walls, strict=True)
        }

    def start(self, known: bool, stream: Stream) -> Belief:
        """See CapsuleFilter."""
        if not known:
            return self._filter.anywhere(stream)
        count = self._filter.params.n
        return self._filter.start(np.repeat(np.array(self._world.route.start)[:, None], count, axis=1))

    def update(
        self, belief: Belief, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, readings: tuple[int, int]
    ) -> tuple[Belief, Located]:
        """See CapsuleFilter."""
        before, now = (self._world.told.at(number) for number in readings)
        announced = now if self._schedule != "ignored" and now != before else None
        belief, finding = self._filter.update(belief, motion, ranges, stream, announced)
        likeliest = max(finding.maps, key=finding.maps.__getitem__)
        return belief, Located(
            finding.pose,
            finding.covariance,
            likeliest,
            {} if self._schedule == "obeyed" else finding.maps,
            finding.changed_at,
            self._moved(finding) if likeliest == UNLISTED else None,
        )

    def _moved(self, finding: Finding) -> Moved:
        points, outwards = self._nodes[finding.reference]
        which = np.flatnonzero(finding.displacement)
        return Moved(finding.reference, points[:, which], finding.displacement[which], outwards[:, which])

    def cloud(self, belief: Belief) -> Cloud:
        """See CapsuleFilter."""
        return belief.cloud

    def freeze(self, belief: Belief) -> Mapping[str, Any]:
        """See CapsuleFilter."""
        return {**belief._asdict(), "cloud": belief.cloud._asdict()}

    def thaw(self, state: Mapping[str, Any]) -> Belief:
        """See CapsuleFilter."""
        return Belief(**{name: _copied(value) for name, value in {**state, "cloud": _thawed(state["cloud"])}.items()})


class _RadiusBelief(NamedTuple):
    """A cloud over pose and radius, and the last reading at which the radius changed."""

    cloud: Cloud
    changed_at: int


class _EndRadius:
    """The filter that estimates the radius of the tube's round end."""

    def __init__(self, table: EndRadiusFilter, world: ColonWorld, key: str) -> None:
        first = world.told.at(0)
        if not first.startswith("end "):
            raise ScenarioError(f"colon.told: {first!r} at the start; the filter 'end_radius' expects an 'end RADIUS'")
        self._world, self._first = world, world.grid(first, "colon.told")
        self._radius = float(first.removeprefix("end "))
        members = {radius: world.grid(f"end {radius:g}", f"{key}.radii_px") for radius in table.radii_px}
        self._filter = EndRadius(table, members)
        self.grids = {f"end {radius:g}": grid for radius, grid in members.items()}

    def start(self, known: bool, stream: Stream) -> _RadiusBelief:
        """See CapsuleFilter."""
        poses = _start_poses(self._world, self._first, self._filter.params.n, known, stream)
        return _RadiusBelief(self._filter.start(poses, self._radius), 0)

    def update(
        self,
        belief: _RadiusBelief,
        motion: CapsuleMotion | None,
        ranges: Floats,
        stream: Stream,
        readings: tuple[int, int],
    ) -> tuple[_RadiusBelief, Located]:
        """See CapsuleFilter."""
        cloud, finding = self._filter.update(belief.cloud, motion, ranges, stream)
        changed_at = readings[1] if finding.changed > 0.5 else belief.changed_at
        covariance = pose_estimate(cloud.particles, cloud.weights).covariance
        nearest = float(self._filter.radii[np.abs(self._filter.radii - finding.radius).argmin()])
        radius = Radius(finding.radius, finding.radius_deviation)
        located = Located(finding.pose, covariance, f"end {nearest:g}", changed_at=float(changed_at), radius=radius)
        return _RadiusBelief(cloud, changed_at), located

    def cloud(self, belief: _RadiusBelief) -> Cloud:
        """See CapsuleFilter."""
        return belief.cloud

    def freeze(self, belief: _RadiusBelief) -> Mapping[str, Any]:
        """See CapsuleFilter."""
        return {"cloud": belief.cloud._asdict(), "changed_at": belief.changed_at}

    def thaw(self, state: Mapping[str, Any]) -> _RadiusBelief:
        """See CapsuleFilter."""
        return _RadiusBelief(_thawed(state["cloud"]), state["changed_at"])


def _start_poses(world: ColonWorld, grid: OccupancyGrid, count: int, known: bool, stream: Stream) -> Floats:
    if known:
        return np.repeat(np.array(world.route.start)[:, None], count, axis=1)
    return Uniform(UniformStart(), grid).draw(count, (), stream)


def _nodes(grid: OccupancyGrid, nodes: Indices, following: Indices) -> tuple[FloatArray, FloatArray]:
    """Return the points (2, J) of a wall's nodes in pixels, and the outward unit vectors (2, J) there.

    OpenCV follows the border of the free area with that on its right, rows counted upwards.
    """
    at = np.stack(grid.to_map(*(nodes + 0.5)))
    along = at[:, following] - at
    left = np.stack((-along[1], along[0]))
    return at, left / np.maximum(hypot(*left), 1e-9)


def _thawed(state: Mapping[str, Any]) -> Cloud:
    arrays = {name: np.array(state[name]) for name in ("particles", "weights", "log_weights")}
    return Cloud(**arrays, n_eff=state["n_eff"], moved=state["moved"], memory=tuple(state["memory"]))


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value
