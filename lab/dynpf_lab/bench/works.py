"""The measured works, by name: an update by ours and an update by plain NumPy, of the same problem.

A full update is motion sampling, likelihood, normalization, estimate and N_eff, systematic resampling. Works with a
laser start every update from the same cloud of a tracking filter, 0.2 m and 0.1 rad wide; those with landmarks or an
adaptive number of particles continue from the last update, as a filter does.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynpf.filters.adaptation import Kld, KldParams
from dynpf.filters.cloud import Cloud, gathered, weighted_cloud
from dynpf.filters.particle import ParticleFilter, Report
from dynpf.filters.resampling import Systematic
from dynpf.maps.landmarks import LandmarkMap
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.beam import BeamModel, BeamParams
from dynpf.measurement.likelihood_field import LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.measurement.scan import Scan
from dynpf.motion.model import Displacement
from dynpf.motion.odometry import OdometryMotion, OdometryParams
from dynpf.rng import Stream, generator
from dynpf_lab.bench import plain
from dynpf_lab.bench.problems import (
    ALPHA,
    RANGE_MAX_M,
    RANGE_MIN_M,
    SIGMA_BEARING,
    SIGMA_RANGE_M,
    LandmarkProblem,
    ScanProblem,
    movement,
)

__all__ = ["BEAMS", "FIELD", "WORKS", "Landmarks", "Step", "Tracked", "Work", "build", "plain_field"]

Step = Callable[[], Any]
Filter = ParticleFilter[NDArray[np.float64]]

BEAMS = {"likelihood_field_60": 60, "likelihood_field_5": 5, "beam_60": 60, "kld": 60}
"""The numbers of beams of works with scans."""
WORKS = ("likelihood_field_60", "likelihood_field_5", "beam_60", "rays_global", "rays_track", "landmarks_15", "kld")

FIELD = LikelihoodFieldParams(max_beams=10_000)
# AMCL's.
BINS, KLD_ERROR = (0.5, math.radians(10.0)), 0.01


class Work(Protocol):
    """A kind of update; the functions that it returns execute an update at each call."""

    threaded: bool

    def ours(self, n: int, threads: int) -> Step:
        """Return our update with ``n`` particles."""
        ...

    def numpy(self, n: int) -> Step:
        """Return plain NumPy's update with ``n`` particles."""
        ...

    def stages(self, n: int) -> Mapping[str, Step]:
        """Return the parts of our update, each alone."""
        ...


def build(name: str, grid: OccupancyGrid, beams: int | None) -> Work:
    """Return a work by its name; ``beams`` overrides the number of beams of its scans."""
    if name == "landmarks_15":
        return Landmarks(LandmarkProblem())
    problem = ScanProblem(grid, beams or BEAMS.get(name, 1))
    if name.startswith("rays_"):
        return Rays(problem, anywhere=name == "rays_global")
    if name == "beam_60":
        return beam_update(problem)
    field = LikelihoodField(FIELD, grid), plain_field(grid)
    return Adapted(problem, *field) if name == "kld" else ScanUpdate(problem, *field)


def plain_field(grid: OccupancyGrid) -> plain.Field:
    """Return the likelihood field of ``FIELD`` in NumPy alone."""
    return plain.Field(
        grid,
        z_hit=FIELD.z_hit,
        z_rand=FIELD.z_rand,
        sigma_hit=FIELD.sigma_hit,
        range_max=RANGE_MAX_M,
        farthest=FIELD.max_distance,
    )


class Tracked(NamedTuple):
    """The result of our update."""

    cloud: Cloud
    report: Report[Any]


class ScanUpdate:
    """A full update with a scan, from the cloud of a tracking filter."""

    threaded = True

    def __init__(
        self, problem: ScanProblem, model: LikelihoodField | BeamModel, baseline: plain.Field | plain.Beams
    ) -> None:
        self.problem = problem
        self.model = model
        self.baseline = baseline

    def ours(self, n: int, threads: int) -> Step:
        """See Work."""
        pf, cloud = self._filter(threads), self._cloud(n)
        control, scan = self.problem.controls[0], self._scan(0)
        streams = _streams()
        return lambda: Tracked(*pf.update(cloud, control, [scan], next(streams)))

    def numpy(self, n: int) -> Step:
        """See Work."""
        cloud, rng = self.problem.cloud(n), _generator()
        made, sigma = movement(self.problem.controls[0])
        angles, ranges = self.problem.angles, self.problem.ranges[0]
        return lambda: plain.update(
            cloud, made, sigma, lambda poses: self.baseline.log_likelihood(poses, angles, ranges), rng
        )

    def stages(self, n: int) -> Mapping[str, Step]:
        """See Work."""
        return _stages(self._filter(1), self._cloud(n), self.problem.controls[0], self._scan(0))

    def _filter(self, threads: int) -> Filter:
        return ParticleFilter(_motion(), {Scan: self.model}, resampling=Systematic(when="always"), threads=threads)

    def _cloud(self, n: int) -> Cloud:
        return self._filter(1).start(self.problem.cloud(n), next(_streams()))

    def _scan(self, step: int) -> Scan:
        return Scan(self.problem.angles, self.problem.ranges[step], RANGE_MIN_M, RANGE_MAX_M)


class Adapted(ScanUpdate):
    """Successive full updates, back and forth, in which KLD-sampling chooses the number of particles, at most ``n``.

    Each update resamples.
    """

    threaded = True

    def ours(self, n: int, threads: int) -> Step:
        """See Work."""
        params = KldParams(
            epsilon=KLD_ERROR, cell_x=BINS[0], cell_y=BINS[0], cell_heading=BINS[1], n_min=min(n, 100), n_max=n
        )
        resampling = Systematic(when="always")
        pf: Filter = ParticleFilter(
            _motion(), {Scan: self.model}, resampling=resampling, sizing=Kld(params), threads=threads
        )
        cloud, streams, steps = self._cloud(min(n, 2000)), _streams(), itertools.count()

        def update() -> Tracked:
            nonlocal cloud
            step = next(steps) % len(self.problem.controls)
            done = Tracked(*pf.update(cloud, self.problem.controls[step], [self._scan(step)], next(streams)))
            cloud = done.cloud
            return done

        return update

    def numpy(self, n: int) -> Step:
        """See Work."""
        cloud, rng, steps = self.problem.cloud(min(n, 2000)), _generator(), itertools.count()
        moves = [movement(control) for control in self.problem.controls]

        def update() -> plain.Updated:
            nonlocal cloud
            step = next(steps) % len(moves)
            poses = plain.moved(cloud, *moves[step], rng)
            weights = plain.normalized(
                self.baseline.log_likelihood(poses, self.problem.angles, self.problem.ranges[step])
            )
            cloud = plain.adapted(poses, weights, n, rng, bins=BINS, error=KLD_ERROR)
            return plain.Updated(cloud, plain.mean(poses, weights), 1.0 / float(np.sum(weights * weights)))

        return update

    def stages(self, n: int) -> Mapping[str, Step]:  # noqa: ARG002
        """Return no parts: the number of particles changes between them."""
        return {}


class Rays:
    """The ranges of n rays: from random positions on the map, or from around a position in all directions."""

    threaded = False

    def __init__(self, problem: ScanProblem, *, anywhere: bool) -> None:
        self.origins = problem.anywhere if anywhere else self._nearby
        self.problem = problem
        self.caster, self.baseline = RayCaster(problem.grid), plain.Rays(problem.grid)

    def _nearby(self, n: int) -> NDArray[np.float32]:
        poses = self.problem.cloud(n)
        poses[2] = generator(0, "bench", 0, "rays").uniform(-np.pi, np.pi, n)
        return poses

    def ours(self, n: int, threads: int) -> Step:  # noqa: ARG002
        """See Work."""
        x, y, angles = self.origins(n)
        return lambda: self.caster.ranges(x, y, angles, RANGE_MAX_M)

    def numpy(self, n: int) -> Step:
        """See Work."""
        x, y, angles = self.origins(n)
        return lambda: self.baseline.ranges(x, y, angles, RANGE_MAX_M)

    def stages(self, n: int) -> Mapping[str, Step]:  # noqa: ARG002
        """Return no parts: a ray is not an update of a filter."""
        return {}


class Landmarks:
    """Successive full updates on the lap of a robot that sees 15 landmarks."""

    threaded = True

    def __init__(self, problem: LandmarkProblem) -> None:
        self.problem = problem
        # The peers have Gaussian errors only, without gate, outliers or tempering.
        params = RangeBearingParams(
            sigma_range=SIGMA_RANGE_M,
            sigma_range_per_m=0.0,
            sigma_bearing=SIGMA_BEARING,
            gate=None,
            outlier_fraction=0.0,
            tempering=1.0,
        )
        ids = np.arange(len(problem.landmarks))
        known = LandmarkMap((int(i), float(x), float(y)) for i, (x, y) in zip(ids, problem.landmarks, strict=True))
        self.model = RangeBearing(params, known)
        self.readings = [
            RangeBearingReadings(ids, ranges, bearings)
            for ranges, bearings in zip(
                problem.ranges.astype(np.float32), problem.bearings.astype(np.float32), strict=True
            )
        ]

    def ours(self, n: int, threads: int) -> Step:
        """See Work."""
        pf, cloud = self._filter(threads), self._cloud(n)
        streams, steps = _streams(), itertools.count()

        def update() -> Tracked:
            nonlocal cloud
            reading = self.readings[next(steps) % len(self.readings)]
            done = Tracked(*pf.update(cloud, self.problem.control, [reading], next(streams)))
            cloud = done.cloud
            return done

        return update

    def numpy(self, n: int) -> Step:
        """See Work."""
        baseline = plain.Landmarks(self.problem.landmarks, SIGMA_RANGE_M, SIGMA_BEARING)
        cloud, rng, steps = self.problem.cloud(n), _generator(), itertools.count()
        made, sigma = movement(self.problem.control)

        def update() -> plain.Updated:
            nonlocal cloud
            step = next(steps) % len(self.readings)
            seen = self.problem.ranges[step], self.problem.bearings[step]
            done = plain.update(cloud, made, sigma, lambda poses: baseline.log_likelihood(poses, *seen), rng)
            cloud = done.particles
            return done

        return update

    def stages(self, n: int) -> Mapping[str, Step]:
        """See Work."""
        return _stages(self._filter(1), self._cloud(n), self.problem.control, self.readings[0])

    def _filter(self, threads: int) -> Filter:
        models: dict[type, RangeBearing] = {RangeBearingReadings: self.model}
        return ParticleFilter(_motion(), models, resampling=Systematic(when="always"), threads=threads)

    def _cloud(self, n: int) -> Cloud:
        return self._filter(1).start(self.problem.cloud(n), next(_streams()))


def beam_update(problem: ScanProblem) -> ScanUpdate:
    """Return the full update with the beam model and exact rays."""
    params = BeamParams(max_beams=10_000)
    shares = (params.z_hit, params.z_short, params.z_max, params.z_rand)
    baseline = plain.Beams(problem.grid, shares, params.sigma_hit, params.lambda_short, RANGE_MAX_M)
    return ScanUpdate(problem, BeamModel(params, problem.grid), baseline)


def _stages(pf: Filter, cloud: Cloud, control: Displacement, reading: Any) -> Mapping[str, Step]:
    """Return each part of an update, on the arrays that it would have there."""
    models, streams = pf.models, _streams()
    moved = models.propagate(cloud.particles, control, next(streams))
    evidence, _ = models.believable(moved, cloud.weights, [reading])
    scores = models.log_likelihood(moved, evidence)
    weighted, _ = weighted_cloud(moved, scores)

    def resampled() -> Any:
        return gathered(moved, pf.resampling.select(weighted.weights, weighted.weights.size, next(streams)))

    return {
        "motion": lambda: models.propagate(cloud.particles, control, next(streams)),
        "likelihood": lambda: models.log_likelihood(moved, models.believable(moved, cloud.weights, [reading])[0]),
        "normalization": lambda: weighted_cloud(moved, scores),
        "estimate": lambda: pf.estimate(moved, weighted.weights),
        "resampling": resampled,
    }


def _motion() -> OdometryMotion:
    return OdometryMotion(OdometryParams(alpha_1=ALPHA, alpha_2=ALPHA, alpha_3=ALPHA, alpha_4=ALPHA))


def _streams() -> Iterator[Stream]:
    return (Stream.of(0, "bench", step) for step in itertools.count())


def _generator() -> np.random.Generator:
    return np.random.Generator(np.random.Philox(0))
