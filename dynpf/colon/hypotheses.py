"""Localization in a map that may change: which map holds is part of what is estimated.

A particle is a pose with what it implies about the map: probabilities over the listed maps and "none of these", and
there a Gaussian over how far the walls of a reference map have moved. All of that is updated in closed form, so that
only poses are sampled (Rao-Blackwellization; Murphy and Russell, 2001), as FastSLAM does for landmarks (Montemerlo et
al., 2002). The likelihood is brought in by degrees (Neal, 2001): a share of it at a time, as much as halves the
effective number of particles, then resampling and a kernel that keeps mean and covariance (Liu and West, 2001).
"""

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from dynpf import kernels
from dynpf.colon.wall import Wall
from dynpf.colon.world import BEAMS, RANGE_MAX
from dynpf.filters.cloud import Cloud, gathered, uniform_cloud, weighted_cloud
from dynpf.filters.estimate import Mode, modes
from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.resampling import Indices, systematic
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.motion.capsule import CapsuleMotion, CapsuleStep, CapsuleStepParams
from dynpf.params import validated
from dynpf.rng import Stream
from dynpf.se2 import FloatArray, Floats

__all__ = ["UNLISTED", "Belief", "Finding", "Hypotheses", "HypothesesParams"]

UNLISTED = "none of these"

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]


class HypothesesParams(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="colon_hypotheses"
):
    """Lengths in map units (px)."""

    n: Annotated[int, Meta(ge=1)] = 100  # particles
    n_global: Annotated[int, Meta(ge=1)] = 5000  # while the pose is unknown
    motion: CapsuleStepParams = CapsuleStepParams()
    sigma_map: Positive = 1.0  # of a range, in a map that is right: drawing and particles are no finer
    sigma_still: Positive = 1.0  # the same of a wall that has not moved where others have
    sigma_range: NonNegative = 0.0  # of the sensor's noise
    outliers: Annotated[float, Meta(gt=0.0, lt=0.9)] = 0.02  # share of ranges that mean nothing
    change: Share = 0.01  # probability that a map gives way to another within a step
    told: Share = 0.5  # the same when the filter has been told so
    deviation: Positive = 25.0  # of a wall that has moved to where nobody knows
    length: Positive = 35.0  # along the wall over which displacements are alike
    spacing: Positive = 25.0  # of the nodes along the wall
    roughness: Positive = 5.0  # of a moved wall about what moves alike
    growth: NonNegative = 1.0  # of how far an unlisted wall moves on within a step
    unrest: Share = 0.1  # how much of what is known of whether a wall has moved is forgotten within a step
    first_share: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.3  # probability that an unlisted change is where a beam ends
    settled: Annotated[float, Meta(gt=0.5, le=1.0)] = 0.97  # weight of one cluster that ends a global start
    patience: Annotated[int, Meta(ge=0)] = 7  # readings after which a global start ends anyway


class Belief(NamedTuple):
    """All that the filter knows: a cloud of poses (3, N), and what each implies about the map.

    ``maps`` (K + 1, N): probabilities of the listed maps and of UNLISTED; ``since`` (K + 1, N): the expected number of
    the reading at which each began to hold. ``displacement`` (N, J) of the nodes of the ``reference`` map's wall, and
    their covariance (J, J), if UNLISTED holds and the node has moved, of which ``chances`` (J,) are the probabilities. ``reading``: how many have been taken. ``settled``: the pose is known.
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


class Finding(NamedTuple):
    """What an update found, before particles are chosen anew.

    ``pose`` (3,) and ``covariance`` (3, 3): of the heaviest cluster, of weight ``mass``. ``maps``: the posterior over
    the listed maps and UNLISTED. ``changed_at``: the expected reading at which the likeliest of them began to hold; 0
    if it always did. ``displacement`` (J,): how far each node of the ``reference`` map's wall has moved, if UNLISTED.
    """

    pose: FloatArray
    covariance: FloatArray
    mass: float
    maps: dict[str, float]
    changed_at: float
    reference: str
    displacement: Floats
    layers: int


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
        frames = {(grid.cells.shape, grid.resolution, grid.origin) for grid in self.grids}
        if len(frames) > 1:
            raise ValueError(f"the maps {', '.join(maps)} differ in size, resolution or origin: expected the same")
        self._motion = CapsuleStep(params.motion)
        self._casters = tuple(RayCaster(grid) for grid in self.grids)
        self._walls = tuple(Wall.of(grid, params.spacing, params.length, params.deviation) for grid in self.grids)
        self._sigma = math.hypot(params.sigma_map, params.sigma_range)
        self._sigma_still = math.hypot(params.sigma_still, params.sigma_range)
        self._roughness = math.hypot(params.roughness, params.sigma_range)
        self._kernel = GaussianKernel(shrink=True)
        self._angles = np.array(BEAMS, dtype=np.float32)

    def start(self, poses: Floats, *, known: bool = True) -> Belief:
        """Return the belief at poses (3, N) of equal weight; ``known``: they are of one place, not from anywhere."""
        cloud = uniform_cloud(np.ascontiguousarray(poses, dtype=np.float32))
        maps = np.zeros((len(self.names), poses.shape[1]), dtype=np.float32)
        maps[0] = 1.0
        prior = self._walls[0].prior
        displacement = np.zeros((poses.shape[1], len(prior)), dtype=np.float32)
        return Belief(cloud, maps, np.zeros_like(maps), displacement, prior.copy(), self._fresh_chances(0), 0, 0, known)

    def anywhere(self, stream: Stream) -> Belief:
        """Return the belief that knows nothing: poses uniform over the first map's inside."""
        return self.start(self.grids[0].sample_free(self.params.n_global, stream), known=False)

    def update(
        self, belief: Belief, motion: CapsuleMotion | None, ranges: Floats, stream: Stream, told: str | None = None
    ) -> tuple[Belief, Finding]:
        """Return the belief after a motion (None: none) and ranges (B,) at its end, and what was found.

        ``told``: the name of a listed map that is said to hold from now on, whether or not that is true. Ranges that
        are NaN tell nothing. Raises ValueError for another number of ranges, or a name that is not listed.
        """
        read = self._checked(ranges)
        if told is not None and told not in self.names[:-1]:
            raise ValueError(f"told of map {told!r}: expected one of {', '.join(self.names[:-1])}")
        particles = belief.cloud.particles
        if motion is not None:
            particles = self._motion.propagate(particles, motion, stream.part("motion"))
        moved = belief._replace(cloud=belief.cloud._replace(particles=particles), reading=belief.reading + 1)
        if not belief.settled:
            return self._search(moved, read, stream)
        return self._follow(self._expect_change(moved, told), read, stream)

    def _checked(self, ranges: Floats) -> Floats:
        read = np.array(ranges, dtype=np.float32)
        if read.shape != self._angles.shape:
            raise ValueError(f"ranges of shape {read.shape}; expected one for each of {self._angles.size} beams")
        read[~(read >= 0.0)] = np.nan
        return np.minimum(read, np.float32(RANGE_MAX))

    # Maps and walls.

    def _expect_change(self, belief: Belief, told: str | None) -> Belief:
        """Let every map give way to the others, and walls that nobody knows move on."""
        params, count = self.params, len(self.names)
        transition = np.full((count, count), params.change / (count - 1), dtype=np.float32)
        np.fill_diagonal(transition, 1.0 - params.change)
        if told is not None:
            to = self.names.index(told)
            transition *= 1.0 - params.told
            transition[:, to] += params.told
        stayed = np.diag(transition)[:, None] * belief.maps
        maps = np.einsum("kn,kl->ln", belief.maps, transition)
        fresh = (maps - stayed) / np.maximum(maps, np.float32(1e-30))
        since = belief.since + fresh * (np.float32(belief.reading - 1) - belief.since)
        return self._forget_walls(belief._replace(maps=maps, since=since), fresh[-1])

    def _forget_walls(self, belief: Belief, fresh: Floats) -> Belief:
        """Mix displacements with those of a change that has only just happened, ``fresh`` (N,) the probability."""
        params = self.params
        total = np.sum(belief.cloud.weights * belief.maps, axis=1, dtype=np.float64)
        reference = belief.reference
        if total[-1] < 0.01 and total[:-1].max() > 0.97:
            reference = int(total[:-1].argmax())
        wall = self._walls[reference]
        if reference != belief.reference:
            displacement = np.zeros((len(fresh), len(wall.prior)), dtype=np.float32)
            return belief._replace(
                displacement=displacement,
                covariance=wall.prior.copy(),
                chances=self._fresh_chances(reference),
                reference=reference,
            )
        unlisted = belief.cloud.weights * belief.maps[-1]
        share = np.float32(np.sum(unlisted * fresh) / max(float(np.sum(unlisted)), 1e-30))
        moves_on = np.float32((params.growth / params.deviation) ** 2)
        covariance = share * wall.prior + (1 - share) * belief.covariance
        covariance += (1 - share) * moves_on * wall.prior
        displacement = belief.displacement * (1 - fresh)[:, None]
        renewed = share + (1 - share) * np.float32(params.unrest)
        chances = belief.chances + renewed * (self._fresh_chances(reference) - belief.chances)
        return belief._replace(displacement=displacement, covariance=covariance, chances=chances)

    def _fresh_chances(self, reference: int) -> Floats:
        return np.full(len(self._walls[reference].prior), self.params.first_share, dtype=np.float32)

    # Likelihoods.

    def _expected(self, caster: RayCaster, particles: Floats) -> Floats:
        """Return the ranges (B, N) that particles expect in a map."""
        beams, count = self._angles.size, particles.shape[1]
        directions = (particles[2] + self._angles[:, None]).ravel()
        x, y = np.tile(particles[0], beams), np.tile(particles[1], beams)
        return caster.ranges(x, y, directions, RANGE_MAX).reshape(beams, count)

    def _listed(self, index: int, particles: Floats, read: Floats) -> tuple[Floats, Floats]:
        """Return the log-likelihood (N,) of the ranges in a listed map, and what is expected there."""
        expected = self._expected(self._casters[index], particles)
        out = np.empty(particles.shape[1], dtype=np.float32)
        kernels.colon.listed(expected, read, self._sigma, self.params.outliers, RANGE_MAX, out)
        return out, expected

    def _evidence(self, particles: Floats, belief: Belief, ancestors: Indices, read: Floats) -> "_Evidence":
        """Return the log-likelihood of the ranges under every hypothesis, for poses whose walls are the ancestors'."""
        count, beams = particles.shape[1], self._angles.size
        log_likelihood = np.empty((len(self.names), count), dtype=np.float32)
        reference = np.empty((0, 0), dtype=np.float32)
        for index in range(len(self.grids)):
            log_likelihood[index], expected = self._listed(index, particles, read)
            if index == belief.reference:
                reference = expected
        wall, params = self._walls[belief.reference], self.params
        column, row = (cells - 0.5 for cells in self.grids[0].to_cells(particles[0], particles[1]))
        blame, stopped_at, shares = np.empty((3, beams, count), dtype=np.float32)
        places = np.empty((beams, count), dtype=np.int32)
        kernels.colon.changed(
            column.astype(np.float32),
            row.astype(np.float32),
            particles[2],
            self._angles,
            read,
            reference,
            wall.beyond,
            wall.node,
            wall.share,
            wall.following,
            belief.displacement,
            ancestors,
            belief.covariance,
            belief.chances,
            self._sigma,
            self._sigma_still,
            self._roughness,
            params.outliers,
            RANGE_MAX,
            log_likelihood[-1],
            blame,
            stopped_at,
            places,
            shares,
        )
        return _Evidence(log_likelihood, blame, stopped_at, places, shares)

    # One update where the pose is known.

    def _follow(self, belief: Belief, read: Floats, stream: Stream) -> tuple[Belief, Finding]:
        particles, log_weights = belief.cloud.particles, belief.cloud.log_weights
        count = particles.shape[1]
        ancestors = np.arange(count, dtype=np.int32)
        left, layers = 1.0, 0
        while True:
            evidence = self._evidence(particles, belief, ancestors, read)
            with np.errstate(divide="ignore"):
                joint = np.log(belief.maps[:, ancestors]) + evidence.log_likelihood
            total = np.logaddexp.reduce(joint, axis=0)
            share = _bearable(log_weights, total, left)
            cloud, _ = weighted_cloud(particles, log_weights + np.float32(share) * total)
            left, layers = left - share, layers + 1
            if left <= 0.0 or layers == _MOST_LAYERS:
                break
            layer = stream.part(f"layer {layers}")
            chosen = systematic(cloud.weights, layer.part("resampling").uniform(), self.params.n)
            particles = self._kernel.spread(gathered(particles, chosen), cloud, layer.part("kernel"))
            ancestors = ancestors[chosen]
            log_weights = np.full(chosen.size, -math.log(chosen.size), dtype=np.float32)
        belief = self._learn(belief, cloud, ancestors, evidence, np.exp(joint - total))
        return belief, self._finding(belief, layers)

    def _learn(
        self, belief: Belief, cloud: Cloud, ancestors: Indices, evidence: "_Evidence", maps: Floats
    ) -> Belief:
        """Return the belief of the particles' new poses: maps (K + 1, N) are settled, walls follow the beams."""
        displacement = belief.displacement[ancestors]
        covariance, chances = belief.covariance.copy(), belief.chances.copy()
        kernels.colon.follow_walls(
            evidence.blame,
            evidence.stopped_at,
            evidence.places,
            evidence.shares,
            self._walls[belief.reference].following,
            self._roughness,
            cloud.weights * maps[-1] + np.float32(1e-30),
            displacement,
            covariance,
            chances,
        )
        return belief._replace(
            cloud=cloud,
            maps=maps,
            since=belief.since[:, ancestors],
            displacement=displacement,
            covariance=covariance,
            chances=chances,
        )

    # A global start.

    def _search(self, belief: Belief, read: Floats, stream: Stream) -> tuple[Belief, Finding]:
        """Weigh by the first map alone, and bear only as much of it as keeps half of the particles.

        To believe all of the first readings would lock onto one of many places that look alike.
        """
        cloud = belief.cloud
        log_likelihood, _ = self._listed(0, cloud.particles, read)
        share = _bearable(cloud.log_weights, log_likelihood, 1.0)
        cloud, _ = weighted_cloud(cloud.particles, cloud.log_weights + np.float32(share) * log_likelihood)
        best = _best(cloud)
        finding = self._finding(belief._replace(cloud=cloud), 1)
        if best.mass >= self.params.settled or belief.reading > self.params.patience:
            chosen = systematic(cloud.weights, stream.part("settled").uniform(), self.params.n)
            settled = self.start(gathered(cloud.particles, chosen))
            return settled._replace(reading=belief.reading), finding
        chosen = systematic(cloud.weights, stream.part("resampling").uniform(), self.params.n_global)
        searching = self.start(gathered(cloud.particles, chosen), known=False)
        return searching._replace(reading=belief.reading), finding

    def _finding(self, belief: Belief, layers: int) -> Finding:
        best = _best(belief.cloud)
        weights = belief.cloud.weights
        posterior = np.sum(weights * belief.maps, axis=1, dtype=np.float64)
        posterior /= posterior.sum()
        likeliest = int(posterior.argmax())
        there = (weights * belief.maps[likeliest]).astype(np.float64)
        changed_at = float(np.sum(there * belief.since[likeliest]) / there.sum())
        unlisted = (weights * belief.maps[-1]).astype(np.float64) + 1e-30
        displacement = np.einsum("n,nj->j", unlisted / unlisted.sum(), belief.displacement)
        return Finding(
            best.mean,
            best.covariance,
            best.mass,
            dict(zip(self.names, posterior.tolist(), strict=True)),
            changed_at,
            self.names[belief.reference],
            displacement,
            layers,
        )


_MOST_LAYERS = 12
_CELL, _CELL_TURN = 20.0, math.radians(30.0)


class _Evidence(NamedTuple):
    log_likelihood: Floats
    blame: Floats
    stopped_at: Floats
    places: Indices
    shares: Floats


def _best(cloud: Cloud) -> Mode:
    """Return the heaviest cluster of poses."""
    return modes(cloud.particles, cloud.weights, cell_m=_CELL, cell_rad=_CELL_TURN, min_mass=0.0)[0]


def _bearable(log_weights: Floats, log_likelihood: Floats, left: float) -> float:
    """Return the largest share, up to ``left``, of a log-likelihood (N,) that leaves N_eff at half of N."""
    weights = np.empty_like(log_weights)

    def thins(share: float) -> bool:
        _, total, squares = kernels.cloud.normalize(log_weights + np.float32(share) * log_likelihood, weights)
        return bool(total * total < 0.5 * log_weights.size * squares)

    if not thins(left):
        return left
    low, high = 0.0, left
    for _ in range(20):
        middle = 0.5 * (low + high)
        if thins(middle):
            high = middle
        else:
            low = middle
    return max(low, 1e-4 * left)
