"""Tubes, trials and filters of the COLON studies."""

import hashlib
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import File, Scenario

from dynpf.colon import (
    ROUTE,
    Capsule,
    Classic,
    EndRadius,
    EndRadiusParams,
    Hypotheses,
    HypothesesParams,
    Run,
)
from dynpf.colon.maps import drawn_map, tube_map
from dynpf.colon.outline import UNIT, Family
from dynpf.colon.world import Route, blown, read_ranges, steered, timeline
from dynpf.filters.start import Uniform, UniformStart
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.maps.timeline import MapTimeline
from dynpf.rng import Stream, generator
from dynpf.types import FloatArray, Floats
from dynpf_systems.colon.config import (
    CapsuleConfig,
    CapsuleEstimatorConfig,
    CapsuleSensorsConfig,
    ClassicFilter,
    EndRadiusFilter,
    HypothesesFilter,
)
from dynpf_systems.colon.tube import ColonConfig, MapHolds, RouteConfig

__all__ = [
    "NOISES",
    "RADII",
    "Change",
    "Filter",
    "Noise",
    "Track",
    "Trial",
    "Tube",
    "caster",
    "follow",
    "grid",
    "run",
    "scenario_of",
]

MapFilter = Literal["seed", "scheduled", "told", "hypotheses"]
Filter = Literal[MapFilter, "end_radius"]
Noise = Literal["none", "3px_5pct", "10px", "robot", "robot_3px_5pct"]


class Setup(NamedTuple):
    """The capsule, and the noise that the filter assumes."""

    capsule: Capsule
    sigma_range: float
    outliers: float


NOISES: dict[Noise, Setup] = {
    "none": Setup(Capsule(), 0.0, 0.002),
    "3px_5pct": Setup(Capsule(sigma_range=3.0, outlier_fraction=0.05), 3.0, 0.08),
    "10px": Setup(Capsule(sigma_range=10.0), 10.0, 0.01),
    "robot": Setup(Capsule(sigma=0.1, sigma_theta=0.1), 0.0, 0.002),
    "robot_3px_5pct": Setup(Capsule(sigma=0.1, sigma_theta=0.1, sigma_range=3.0, outlier_fraction=0.05), 3.0, 0.08),
}
RADII = {"M_1": 3.5 * UNIT, "M_2": 4.0 * UNIT, "M_3": 4.5 * UNIT}
"""Radii of COLON's round ends, px."""
_MEMBERS = tuple(float(radius) for radius in range(90, 166, 5))


class Tube(NamedTuple):
    """The tube and route of trials: a tube of a family, or a user's bitmaps of maps a, b and c."""

    family: Family | None
    seed: int
    files: tuple[str, ...] = ()
    route: Route = ROUTE

    @property
    def name(self) -> str:
        """The name of the family, or "own" for a user's bitmaps."""
        return self.family.value if self.family else "own"


class Change(NamedTuple):
    """The map at the start; those that become true, one at each reading; and the map then given to the filter."""

    before: str
    true: tuple[str, ...]
    told: str

    def true_maps(self, route: Route) -> MapTimeline[str]:
        """Return the schedule of the true maps."""
        return timeline(self.before, *self.true, route=route)


class Track(NamedTuple):
    """A filter's estimates at each reading: poses (3, T + 1), the posterior over maps, particles (3, N).

    The pose's covariance (3, 3) and the radius of the end are those of the last reading.
    """

    poses: FloatArray
    maps: Sequence[dict[str, float]] = ()
    clouds: Sequence[Floats] = ()
    covariance: FloatArray | None = None
    radius: float | None = None


@lru_cache(maxsize=64)
def grid(tube: Tube, name: str) -> OccupancyGrid:
    """Return a map of a tube by its name: see ``tube_map``; of a user's bitmaps, a, b and c.

    Raises UsageError for a user's file that is not a map.
    """
    if tube.family is None:
        return _drawn(tube.files["abc".index(name)], tube.route)
    return tube_map(tube.family, tube.seed, name, tube.route.poses())


def _drawn(file: str, route: Route) -> OccupancyGrid:
    try:
        return drawn_map(Path(file).read_bytes(), file, route.poses())
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(str(error)) from error


@lru_cache(maxsize=64)
def caster(tube: Tube, name: str) -> RayCaster:
    """Return a ray caster in a map of a tube."""
    return RayCaster(grid(tube, name))


class Trial(NamedTuple):
    """A run of the capsule and a filter that follows it; with ``known`` the filter is given the start pose."""

    tube: Tube
    change: Change
    noise: Noise
    filter: Filter
    n: int
    known: bool
    seed: int


def scenario_of(trial: Trial) -> Scenario:
    """Return the scenario whose run is the trial: its nodes compute the same as ``run`` and ``follow``."""
    tube, change, setup = trial.tube, trial.change, NOISES[trial.noise]
    route, capsule = tube.route, setup.capsule
    noise: dict[str, Any] = {"n": trial.n, "sigma_range": setup.sigma_range, "outliers": setup.outliers}
    schedules: dict[Filter, Literal["ignored", "hint", "obeyed"]] = {"scheduled": "obeyed", "told": "hint"}
    chosen: ClassicFilter | EndRadiusFilter | HypothesesFilter
    match trial.filter:
        case "seed":
            chosen = ClassicFilter(n=trial.n)
        case "end_radius":
            chosen = EndRadiusFilter(**noise, radii_px=_MEMBERS)
        case name:
            chosen = HypothesesFilter(**noise, maps=("a", "b"), schedule=schedules.get(name, "ignored"))
    files = {Path(file).name: Path(file).read_bytes() for file in tube.files}
    return load_scenario("colon-case-1").changed(
        seed=trial.seed,
        colon=ColonConfig(
            family=tube.family.value if tube.family else "haustra",
            tube=tube.seed,
            route=RouteConfig(start=route.start, motions=tuple((motion.rho, motion.turn) for motion in route.motions)),
            true=_holding(change.true_maps(route)),
            told=_holding(timeline(change.before, change.told, route=route)),
        ),
        maps=tuple(files),
        files={name: File(sha256=hashlib.sha256(data).hexdigest(), data=data) for name, data in files.items()},
        simulator=CapsuleConfig(sigma_px=capsule.sigma, sigma_theta=capsule.sigma_theta),
        sensors=CapsuleSensorsConfig(sigma_range_px=capsule.sigma_range, outlier_fraction=capsule.outlier_fraction),
        estimator=CapsuleEstimatorConfig(filter=chosen, start="known" if trial.known else "anywhere"),
    )


def _holding(maps: MapTimeline[str]) -> tuple[MapHolds, ...]:
    return tuple(MapHolds(map=name, from_reading=int(first)) for first, name in maps.entries)


def run(trial: Trial) -> Run:
    """Return the true poses and the readings of a trial, which are those of its scenario's run.

    Maps and filters are cached in each process, since making them takes most of the time of a run.
    """
    route, true, capsule = trial.tube.route, trial.change.true_maps(trial.tube.route), NOISES[trial.noise].capsule
    goals = route.poses()
    noisy = capsule.sigma > 0.0 or capsule.sigma_theta > 0.0
    pose, poses, motions, ranges, maps = goals[:, 0], [], [], [], []
    for step in range(len(route.motions) + 1):
        here = caster(trial.tube, true.at(step))
        if step > 0:
            motion = steered(pose, goals[:, step]) if noisy else route.motions[step - 1]
            motions.append(motion)
            pose = blown(pose, motion, capsule, here.grid, generator(trial.seed, "simulator", step, "motion"))
        poses.append(pose)
        maps.append(true.at(step))
        seen_from = np.array([pose[0], pose[1], math.remainder(pose[2], math.tau)])
        ranges.append(read_ranges(here, seen_from, capsule, generator(trial.seed, "sensors", step, "ranges")))
    return Run(np.stack(poses, axis=1), tuple(motions), np.stack(ranges, axis=1), tuple(maps))


def follow(trial: Trial, happened: Run) -> tuple[Track, ...]:
    """Return the filter's track; for COLON's filter two: by its mean, and as its program reports."""
    if trial.filter == "seed":
        return _follow_seed(trial, happened)
    if trial.filter == "end_radius":
        return (_follow_radius(trial, happened),)
    hypotheses = _hypotheses(trial.tube, trial.noise, trial.n, trial.filter == "scheduled")
    start = _start_stream(trial.seed)
    belief = hypotheses.start(_known(trial)) if trial.known else hypotheses.anywhere(start)
    change = trial.change
    scheduled = change.told if trial.filter in {"scheduled", "told"} and change.told != change.before else None
    found, clouds = [], []
    for step, ranges in enumerate(happened.ranges.T):
        announced = scheduled if step == trial.tube.route.change + 1 else None
        motion = happened.motions[step - 1] if step else None
        belief, finding = hypotheses.update(belief, motion, ranges, _stream(trial.seed, step), announced)
        found.append(finding)
        clouds.append(belief.cloud.particles)
    poses = np.stack([finding.pose for finding in found], axis=1)
    maps = [finding.maps for finding in found]
    # A filter that obeys the schedule does not estimate the map.
    return (Track(poses, () if trial.filter == "scheduled" else maps, clouds, found[-1].covariance),)


@lru_cache(maxsize=8)
def _hypotheses(tube: Tube, noise: Noise, n: int, scheduled: bool) -> Hypotheses:
    setup = NOISES[noise]
    params = HypothesesParams(n=n, sigma_range=setup.sigma_range, outliers=setup.outliers)
    if scheduled:
        params = params.obedient()
    return Hypotheses(params, {name: grid(tube, name) for name in "ab"})


def _follow_seed(trial: Trial, happened: Run) -> tuple[Track, Track]:
    change = trial.change
    classic, schedule = (
        _classic(trial.tube, change.before, change.told),
        timeline(change.before, change.told, route=trial.tube.route),
    )
    anywhere, start = Uniform(UniformStart(), grid(trial.tube, change.before)), _start_stream(trial.seed)
    poses = _known(trial) if trial.known else anywhere.draw(trial.n, (), start)
    cloud = classic.start(poses, _start_stream(trial.seed).part("cloud"))
    found, clouds = [], []
    for step, ranges in enumerate(happened.ranges.T):
        motion = happened.motions[step - 1] if step else None
        cloud, finding = classic.update(cloud, motion, ranges, _stream(trial.seed, step), schedule.at(step))
        found.append(finding)
        clouds.append(cloud.particles)
    mean = np.stack([finding.pose for finding in found], axis=1)
    program = np.stack([finding.program_pose for finding in found], axis=1)
    return Track(mean, clouds=clouds), Track(program, clouds=clouds)


@lru_cache(maxsize=8)
def _classic(tube: Tube, *names: str) -> Classic:
    return Classic({name: grid(tube, name) for name in names})


def _follow_radius(trial: Trial, happened: Run) -> Track:
    family = _family(trial.tube, trial.noise, trial.n)
    cloud, poses = family.start(_known(trial), RADII["M_1"]), []
    for step, ranges in enumerate(happened.ranges.T):
        motion = happened.motions[step - 1] if step else None
        cloud, finding = family.update(cloud, motion, ranges, _stream(trial.seed, step))
        poses.append(finding.pose)
    return Track(np.stack(poses, axis=1), radius=finding.radius)


@lru_cache(maxsize=2)
def _family(tube: Tube, noise: Noise, n: int) -> EndRadius:
    setup = NOISES[noise]
    params = EndRadiusParams(n=n, sigma_range=setup.sigma_range, outliers=setup.outliers)
    return EndRadius(params, {radius: grid(tube, f"end {radius}") for radius in _MEMBERS})


def _known(trial: Trial) -> FloatArray:
    return np.repeat(np.array(trial.tube.route.start)[:, None], trial.n, axis=1)


def _stream(seed: int, step: int) -> Stream:
    """Return the estimator's random numbers for a reading, whose number is that of its step."""
    return Stream.of(seed, "estimator", step, "update").part(step)


def _start_stream(seed: int) -> Stream:
    return Stream.of(seed, "estimator", 0, "start")
