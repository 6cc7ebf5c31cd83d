"""Localization in a map that may change: which map holds is part of what is estimated.

A particle is a pose with what it implies about the map: probabilities over the listed maps and "none of these", and
there a Gaussian over how far the walls of a reference map have moved, or over the height of a bulge at each place. All
of that is updated in closed form, so that only poses are sampled (Rao-Blackwellization; Murphy and Russell, 2001), as
FastSLAM does for landmarks (Montemerlo et al., 2002). What the walls have in common with all particles, the covariance
and whether a part has moved at all, is kept once.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple, Self

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels, portable
from dynpf.colon import exact
from dynpf.colon.annealing import annealed, bearable_share
from dynpf.colon.beams import (
    ANGLES,
    Noise,
    checked_ranges,
    dominant_mode,
    expected_in_each,
    expected_ranges,
    listed_log_likelihood,
)
from dynpf.colon.evidence import Beams, Bulges, Displacements, Evidence, Stops, WallNoise
from dynpf.colon.wall import Wall
from dynpf.filters.cloud import Cloud, gathered, uniform_cloud, weighted_cloud
from dynpf.filters.estimate import pose_estimate
from dynpf.filters.resampling import Indices, systematic
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.types import Count, FloatArray, Floats, NonNegative, OpenShare, Positive, Share

__all__ = ["UNLISTED", "Belief", "Finding", "Hypotheses", "HypothesesParams", "SearchParams"]

UNLISTED = "none of these"

OutlierShare = Annotated[float, Meta(gt=0.0, lt=0.9)]


class SearchParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a pose is found that may be anywhere: with many particles and a blunt likelihood; px.

    To believe all of the first readings would lock onto one of many places that look alike, often the reverse heading.
    """

    n: Count = 5000
    sigma: Positive = 30.0  # of a range
    outliers: OutlierShare = 0.05
    kept: OpenShare = 0.2  # share of the effective particles that a reading leaves
    jitter: NonNegative = 4.0  # by which copies are set apart
    settled: Annotated[float, Meta(gt=0.5, le=1.0)] = 0.97  # weight of one cluster that ends the search
    place: Positive = 20.0  # how far a cluster may be spread then
    heading: Positive = 0.5  # rad, likewise
    patience: Annotated[int, Meta(ge=0)] = 7  # readings after which the search ends anyway


class HypothesesParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Lengths in map units (px).

    The prior of bulges (``bulge_height``, ``bulge_deviation``, ``bulge_width``) fits the bulges of the tubes that
    ``dynpf.colon.maps`` draws, 25 to 50 px high: the filter knows the kind of change that it meets there.
    """

    n: Count = 100  # particles
    motion: CapsuleStepParams = CapsuleStepParams()
    sigma_map: Positive = 1.0  # of a range, in a map that is right: particles are no denser
    sigma_range: NonNegative = 0.0  # of the sensor's noise
    outliers: OutlierShare = 0.002  # share of ranges that mean nothing
    change: Share = 0.015  # probability that a map gives way to another within a step
    told: Share = 0.5  # the same when the filter has been told so
    deviation: Positive = 25.0  # of a wall that has moved to where nobody knows
    length: Positive = 35.0  # along the wall over which displacements are alike
    spacing: Positive = 25.0  # of the nodes along the wall
    roughness: Positive = 3.0  # of where a moved wall is about what its nodes say
    growth: NonNegative = 1.0  # of how far a moved wall moves on within a step
    moved: OpenShare = 0.3  # share of the wall that has moved in an unlisted map
    bulge: Share = 0.7  # probability that an unlisted map is the reference map with a bulge: a bell along the wall
    bulge_height: Positive = 40.0
    bulge_deviation: Positive = 15.0  # of its height
    bulge_width: Positive = 40.0  # standard deviation of the bell
    bulge_roughness: NonNegative = 4.0  # of how far a wall is from being such a bell, besides its roughness
    unrest: Share = 0.1  # how much of what is known of whether a wall has moved is forgotten within a step
    search: SearchParams = SearchParams()

    def obedient(self) -> Self:
        """Return the parameters of a filter that takes the map reported to it for the one that holds."""
        return msgspec.structs.replace(self, change=0.0, told=1.0)


class Belief(NamedTuple):
    """All that the filter knows: a cloud of poses (3, N), and what each implies about the map.

    ``maps`` (K + 1, N): probabilities of the listed maps and of UNLISTED; ``since`` (K + 1, N): the expected number of
    the reading at which each began to hold. If UNLISTED holds: ``displacement`` (N, J) of the nodes of the
    ``reference`` map's wall, their covariance (J, J), and ``chances`` (J,), the probabilities that they have moved at
    all; or it is a bulge: ``log_shapes`` (N, S + 1), log-probabilities of bulges at each of S places and, last, of no
    bulge, with ``heights`` and ``height_variances`` (N, S). ``reading``: how many have been taken. ``settled``: the
    pose is known.
    """

    cloud: Cloud
    maps: Floats
    since: Floats
    displacement: Floats
    covariance: Floats
    chances: Floats
    reference: int
    reading: int
    settled: bool
    log_shapes: Floats
    heights: Floats
    height_variances: Floats


class Finding(NamedTuple):
    """What an update found.

    ``pose`` (3,) and ``covariance`` (3, 3): of the heaviest cluster, of weight ``mass``. ``maps``: the posterior over
    the listed maps and UNLISTED. ``changed_at``: the expected number of the reading from which on the likeliest of
    them holds; 0 if it always did. ``displacement`` (J,): how far the nodes of the ``reference`` map's wall have moved
    if UNLISTED holds, 0 where they more likely have not.
    """

    pose: FloatArray
    covariance: FloatArray
    mass: float
    maps: dict[str, float]
    changed_at: float
    reference: str
    displacement: FloatArray


class Hypotheses:
    """A filter over poses and maps; it has no state: beliefs go in and come out."""

    def __init__(self, params: HypothesesParams, maps: Mapping[str, OccupancyGrid]) -> None:
        """Take the listed maps by name, each the bore of a tube; the first is the one that holds at the start.

        Raises ValueError for a parameter out of range, and where no map is listed or they are not of one frame.
        """
        self.params = validated(params)
        if not maps:
            raise ValueError("no map is listed: expected one at least")
        self.names = (*maps, UNLISTED)
        self.grids = tuple(maps.values())
        if len({(grid.cells.shape, grid.resolution, grid.origin) for grid in self.grids}) > 1:
            raise ValueError(f"the maps {', '.join(maps)} differ in size, resolution or origin: expected the same")
        self.walls = tuple(
            Wall.of(grid, params.spacing, params.length, params.deviation, params.bulge_width) for grid in self.grids
        )
        self._motion = CapsuleStep(params.motion)
        self._casters = tuple(RayCaster(grid) for grid in self.grids)
        self._noise = Noise.of(params.sigma_map, params.sigma_range, params.outliers)
        self._wall_noise = WallNoise(*self._noise, params.roughness, params.sigma_range, params.bulge_roughness)
        self._search_noise = Noise.of(params.search.sigma, params.sigma_range, params.search.outliers)

    def start(self, poses: Floats, *, known: bool = True) -> Belief:
        """Return the belief at poses (3, N) of equal weight; ``known``: they are of one place, not from anywhere."""
        cloud = uniform_cloud(np.ascontiguousarray(poses, dtype=np.float32))
        maps = np.zeros((len(self.names), poses.shape[1]), dtype=np.float32)
        maps[0] = 1.0
        walls, bulges = self._unmoved(0, poses.shape[1]), self._unbulged(0, poses.shape[1])
        return Belief(cloud, maps, np.zeros_like(maps), *walls, 0, 0, known, *bulges)

    def anywhere(self, stream: Stream) -> Belief:
        """Return the belief that knows nothing: poses uniform over the first map's inside."""
        return self.start(self.grids[0].sample_free(self.params.search.n, stream), known=False)

    def update(
        self, belief: Belief, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, told: str | None = None
    ) -> tuple[Belief, Finding]:
        """Return the belief after a motion (None: none) and ranges (B,) at its end, and what was found.

        ``told``: the name of a listed map that is reported to hold from now on, rightly or wrongly. Ranges that are NaN
        carry no information. Raises ValueError for another number of ranges, or a name that is not listed.
        """
        read = checked_ranges(ranges)
        if told is not None and told not in self.names[:-1]:
            raise ValueError(f"told of map {told!r}: expected one of {', '.join(self.names[:-1])}")
        cloud = belief.cloud
        if motion is not None:
            particles = self._motion.propagate(cloud.particles, motion, stream.part("motion"))
            cloud = cloud._replace(particles=particles)
        moved = belief._replace(cloud=cloud, reading=belief.reading + 1)
        if not belief.settled:
            return self._search(moved, read, stream)
        return self._follow(self._expect_change(moved, told), read, stream)

    def _expect_change(self, belief: Belief, told: str | None) -> Belief:
        """Let every map give way to the others."""
        params, count = self.params, len(self.names)
        transition = np.full((count, count), params.change / (count - 1), dtype=np.float32)
        np.fill_diagonal(transition, 1.0 - params.change)
        if told is not None:
            transition *= 1.0 - params.told
            transition[:, self.names.index(told)] += params.told
        maps, since = np.empty_like(belief.maps), np.empty_like(belief.since)
        fresh = np.empty(maps.shape[1], dtype=np.float32)
        reading = np.float32(belief.reading - 1)
        kernels.colon.given_way(belief.maps, belief.since, transition, reading, maps, since, fresh)
        return self._expect_moving(belief._replace(maps=maps, since=since), fresh)

    def _expect_moving(self, belief: Belief, fresh: Floats) -> Belief:
        """Mix what is known of walls with what is of a change that has only just happened, of probability (N,)."""
        params, weights = self.params, belief.cloud.weights
        posterior = np.sum(weights * belief.maps, axis=1)
        likeliest = int(posterior[:-1].argmax())
        if likeliest != belief.reference and posterior[likeliest] > _SURE:
            displacement, covariance, chances = self._unmoved(likeliest, fresh.size)
            log_shapes, heights, variances = self._unbulged(likeliest, fresh.size)
            return belief._replace(
                displacement=displacement,
                covariance=covariance,
                chances=chances,
                reference=likeliest,
                log_shapes=log_shapes,
                heights=heights,
                height_variances=variances,
            )
        _, prior, unknown = self._unmoved(belief.reference, 0)
        unlisted = weights * belief.maps[-1]
        renewed = np.float32(np.sum(unlisted * fresh) / max(float(np.sum(unlisted)), 1e-30))
        growth = params.growth / params.deviation
        moves_on = (1 - renewed) * np.float32(growth * growth)
        forgotten = renewed + (1 - renewed) * np.float32(params.unrest)
        return self._expect_bulging(belief, fresh)._replace(
            displacement=belief.displacement * (1 - fresh)[:, None],
            covariance=(renewed + moves_on) * prior + (1 - renewed) * belief.covariance,
            chances=belief.chances + forgotten * (unknown - belief.chances),
        )

    def _expect_bulging(self, belief: Belief, fresh: Floats) -> Belief:
        """Mix bulges that are known of with any that have only just begun, of probability (N,): by their moments."""
        params = self.params
        begun = np.append(self._begun(belief), exact.log(np.array([1.0 - params.bulge + 1e-30])))
        bulges = Bulges(belief.log_shapes.copy(), belief.heights.copy(), belief.height_variances.copy())
        variance, growth = params.bulge_deviation * params.bulge_deviation, params.growth * params.growth
        kernels.colon_bulges.bulges_given_way(bulges, fresh, begun, params.bulge_height, variance, growth)
        return belief._replace(log_shapes=bulges.log_shapes, heights=bulges.heights, height_variances=bulges.variances)

    def _unmoved(self, reference: int, count: int) -> tuple[Floats, Floats, Floats]:
        """Return displacements, covariance and chances where nothing is known of the walls of a map."""
        prior = self.walls[reference].prior
        displacement = np.zeros((count, len(prior)), dtype=np.float32)
        return displacement, prior.copy(), np.full(len(prior), self.params.moved, dtype=np.float32)

    def _begun(self, belief: Belief) -> Floats:
        """Return the log-probabilities (S,) of bulges that have just begun: where the beams end, as far as they reach.

        Elsewhere they make no difference yet; they count from when they could be seen.
        """
        params, grid, wall = self.params, self.grids[0], self.walls[belief.reference]
        pose = pose_estimate(belief.cloud.particles, belief.cloud.weights).mean
        ranges = expected_ranges(self._casters[belief.reference], pose[:, None])[:, 0]
        sines, cosines = portable.sincos(pose[2] + ANGLES)
        column, row = grid.to_cells(pose[0] + ranges * cosines, pose[1] + ranges * sines)
        height, width = grid.cells.shape
        nodes = wall.node[portable.whole(row, 0, height - 1), portable.whole(column, 0, width - 1)]
        shares = wall.shapes[:, nodes].sum(axis=1) + np.float32(1e-3)
        begun: Floats = exact.log(params.bulge * shares / shares.sum() + 1e-30)
        return begun

    def _unbulged(self, reference: int, count: int) -> tuple[Floats, Floats, Floats]:
        """Return log-probabilities of shapes, heights and their variances where nothing is known of bulges."""
        params, bulges = self.params, len(self.walls[reference].shapes)
        shapes = np.append(np.full(bulges, params.bulge / bulges), 1.0 - params.bulge)
        log_shapes = exact.log(shapes + 1e-30)
        return (
            np.repeat(log_shapes[None], count, axis=0),
            np.full((count, bulges), params.bulge_height, dtype=np.float32),
            np.full((count, bulges), params.bulge_deviation * params.bulge_deviation, dtype=np.float32),
        )

    def _follow(self, belief: Belief, read: Floats, stream: Stream) -> tuple[Belief, Finding]:
        """Update a belief of which the pose is known."""

        def likelihood(particles: Floats, ancestors: Indices) -> tuple[Floats, tuple[Floats, Evidence]]:
            evidence = self._evidence(particles, belief, ancestors, read)
            maps = np.empty_like(evidence.log_likelihood)
            total = np.empty(maps.shape[1], dtype=np.float32)
            kernels.colon.weighed(belief.maps, ancestors, evidence.log_likelihood, maps, total)
            return total, (maps, evidence)

        found = annealed(belief.cloud, likelihood, self.params.n, stream, reserve=lambda found: found[0][-1])
        maps, evidence = found.evidence
        learned = self._learn(belief, found.cloud, found.ancestors, evidence, maps)
        return learned, self._finding(learned)

    def _evidence(self, particles: Floats, belief: Belief, ancestors: Indices, read: Floats) -> Evidence:
        """Return what the ranges say under every hypothesis at particles whose walls are the ancestors'."""
        count, wall = particles.shape[1], self.walls[belief.reference]
        expected = expected_in_each(self._casters, particles)
        log_likelihood = np.empty((len(self.names), count), dtype=np.float32)
        for index, ranges in enumerate(expected):
            kernels.colon.listed(ranges, read, self._noise, log_likelihood[index])
        column, row = self.grids[0].to_cells(particles[0], particles[1])
        x, y = (column - 0.5).astype(np.float32), (row - 0.5).astype(np.float32)
        beams = Beams(x, y, particles[2], ANGLES, read, expected[belief.reference])
        displacements = Displacements(belief.displacement, ancestors, belief.covariance, belief.chances)
        shapeless, stops = np.empty(count, dtype=np.float32), Stops.empty(ANGLES.size, count)
        kernels.colon_walls.changed(beams, wall, displacements, self._wall_noise, shapeless, stops)
        bulges = Bulges(belief.log_shapes[ancestors], belief.heights[ancestors], belief.height_variances[ancestors])
        kernels.colon_bulges.bulged(stops, wall, self._wall_noise, shapeless, log_likelihood[-1], bulges)
        return Evidence(log_likelihood, stops, bulges)

    def _learn(self, belief: Belief, cloud: Cloud, ancestors: Indices, evidence: Evidence, maps: Floats) -> Belief:
        """Return the belief at the particles' new poses: maps (K + 1, N) are settled, walls follow the beams."""
        displacement = belief.displacement[ancestors]
        covariance, chances = belief.covariance.copy(), belief.chances.copy()
        unlisted = cloud.weights * maps[-1] * exact.exp(evidence.bulges.log_shapes[:, -1]) + np.float32(1e-30)
        following = self.walls[belief.reference].following
        kernels.colon_walls.follow_walls(evidence.stops, following, unlisted, displacement, covariance, chances)
        return belief._replace(
            cloud=cloud,
            maps=maps,
            since=belief.since[:, ancestors],
            displacement=displacement,
            covariance=covariance,
            chances=chances,
            log_shapes=evidence.bulges.log_shapes,
            heights=evidence.bulges.heights,
            height_variances=evidence.bulges.variances,
        )

    def _search(self, belief: Belief, read: Floats, stream: Stream) -> tuple[Belief, Finding]:
        """Update a belief whose pose may be anywhere: by the first map alone, and by no more than leaves many."""
        cloud, search = belief.cloud, self.params.search
        expected = expected_ranges(self._casters[0], cloud.particles)
        log_likelihood = listed_log_likelihood(expected, read, self._search_noise)
        share = bearable_share(cloud.log_weights, log_likelihood, 1.0, search.kept)
        cloud, _ = weighted_cloud(cloud.particles, cloud.log_weights + np.float32(share) * log_likelihood)
        finding = self._finding(belief._replace(cloud=cloud))
        ends = self._is_one_place(finding) or belief.reading > search.patience
        chosen = systematic(cloud.weights, stream.part("resampling").uniform(), self.params.n if ends else search.n)
        poses = gathered(cloud.particles, chosen)
        if not ends:
            poses[:2] += np.float32(search.jitter) * stream.part("jitter").normals(2, chosen.size)
        return self.start(poses, known=ends)._replace(reading=belief.reading), finding

    def _is_one_place(self, finding: Finding) -> bool:
        """Return whether a cluster is all that is left, and small: touching cells may also cover the whole tube."""
        search, variance = self.params.search, np.diag(finding.covariance)
        small = variance[0] + variance[1] < search.place * search.place and (
            variance[2] < search.heading * search.heading
        )
        return finding.mass >= search.settled and bool(small)

    def _finding(self, belief: Belief) -> Finding:
        best = dominant_mode(belief.cloud)
        joint = belief.cloud.weights.astype(np.float64) * belief.maps
        posterior = joint.sum(axis=1) / joint.sum(axis=1).sum()
        likeliest = int(posterior.argmax())
        changed_at = float(np.sum(joint[likeliest] * belief.since[likeliest]) / joint[likeliest].sum())
        unlisted = (joint[-1] + 1e-30) / np.sum(joint[-1] + 1e-30)
        displacement = np.empty(belief.chances.size)
        bulges, shapes = (
            Bulges(belief.log_shapes, belief.heights, belief.height_variances),
            self.walls[belief.reference].shapes,
        )
        kernels.colon_bulges.displaced(unlisted, bulges, belief.displacement, belief.chances, shapes, displacement)
        return Finding(
            best.mean,
            best.covariance,
            best.mass,
            dict(zip(self.names, posterior.tolist(), strict=True)),
            changed_at,
            self.names[belief.reference],
            displacement,
        )


_SURE = 0.97  # the posterior from which on a listed map is the one that unknown changes start from
