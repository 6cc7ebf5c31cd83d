"""TURTLEBOT: the number of particles that find a robot by the lines in the view of a narrow depth camera."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_services.sensors.simulated import SimulatedSensorsConfig
from msgspec import Meta

from dynpf.filters.regularization import GaussianKernel
from dynpf.filters.resampling import Systematic
from dynpf.filters.start import FromReadingsStart, UniformStart
from dynpf.maps.line_map import LineMapParams, line_map, placed
from dynpf.measurement.lines import PolarLinesParams
from dynpf.measurement.scan_lines import ScanLinesParams
from dynpf.measurement.split_and_merge import SplitAndMergeParams, extract_lines
from dynpf.types import Count
from dynpf_systems.rooms.config import Door
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.studies.figures import Shown, draw
from dynpf_systems.rooms.studies.ways import (
    SEARCH_COLUMNS,
    Epoch,
    Way,
    World,
    dead_reckoning,
    follow,
    known_start,
    load_world,
    measures,
    played,
    record,
    scans,
)

__all__ = ["STUDY", "TurtlebotSettings", "configured"]

Start = Literal["known", "uniform", "heading", "readings"]
Filter = Literal["document", "careful", "landmarks"]

PANELS = {
    "turtlebot-room": ((2.0, 0.9, 2.0, 1.3), (0.9, 2.3, 1.3, 2.6)),
    "turtlebot-loops": ((-9.6, 2.4, -9.6, 3.6), (-6.6, 6.4, -5.4, 6.4), (-2.3, 2.6, -2.3, 3.8), (-6.0, 1.6, -4.6, 1.6)),
}
"""Line segments missing in the map and parallel to its walls, which cause false associations."""


LASER = ScanLinesParams(
    extraction=SplitAndMergeParams(min_points=6, min_length=0.5),
    lines=PolarLinesParams(
        sigma_rho=0.1, sigma_alpha=0.08, sigma_along=0.2, length_tolerance=0.3, outlier_fraction=0.2, outlier_rho=10.0
    ),
    tempering=0.25,
    hidden=0.5,
)
"""Line extraction for a laser's scans of a furnished building."""


class TurtlebotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The worlds, the particle counts, the length of a drive, and a log to use instead of the worlds."""

    worlds: tuple[Literal["turtlebot-room", "turtlebot-loops"], ...] = ("turtlebot-room", "turtlebot-loops")
    n: tuple[Count, ...] = (50, 100, 200, 500, 1000, 2000, 5000)
    n_known: Count = 5000  # the most for a known start
    n_panels: Count = 1000  # for the case panels
    updates: Annotated[int, Meta(ge=20)] = 100
    log: str = (
        ""  # an imported log with scans and a reference, instead of the worlds; its walls are extracted from them
    )
    loops: Annotated[int, Meta(ge=20)] = 370  # updates of the drive on which odometry is compared: two loops


class Case(NamedTuple):
    """A filter's configuration on a drive."""

    case: Literal["drive", "panels"]
    start: Start
    filter: Filter
    n: int


class Part(NamedTuple):
    """All cases of one world and seed, so that its drives are simulated once."""

    settings: TurtlebotSettings
    world: str
    seed: int
    cases: tuple[Case, ...]


def _cases_of_log(settings: TurtlebotSettings) -> Iterator[Case]:
    for n in settings.n:
        if n <= settings.n_known:
            yield Case("drive", "known", "document", n)
            yield Case("drive", "known", "careful", n)
            yield Case("drive", "readings", "careful", n)


def _cases(settings: TurtlebotSettings, name: str) -> Iterator[Case]:
    landmarks: tuple[Filter, ...] = ("landmarks",) if load_world(name).scenario.landmarks else ()
    for n in settings.n:
        for start in ("known", "heading", "uniform", "readings"):
            if start in {"uniform", "readings"} or n <= settings.n_known:
                yield Case("drive", start, "careful", n)
            if start == "uniform" or (start != "readings" and n <= settings.n_known):
                yield Case("drive", start, "document", n)
        for filter_name in landmarks:
            yield Case("drive", "readings", filter_name, n)
    for filter_name in ("document", "careful"):
        yield Case("panels", "known", filter_name, settings.n_panels)


def _parts(settings: TurtlebotSettings, trials: int, seed: int) -> list[Part]:
    if settings.log:
        cases = tuple(_cases_of_log(settings))
        return [Part(settings, settings.log, seed + trial, cases) for trial in range(trials)]
    return [
        Part(settings, name, seed + trial, tuple(_cases(settings, name)))
        for trial in range(trials)
        for name in settings.worlds
    ]


@lru_cache(maxsize=2)
def _walls(log: str) -> World:
    """Return the world of a log, its walls extracted from its scans at the reference's poses."""
    drive = played(Path(log))
    seen = (placed(extract_lines(scan, LASER.extraction), truth) for truth, scan in scans(drive.world, drive.epochs))
    world = drive.world
    estimator = world.scenario.estimator
    assert isinstance(estimator, LocalizationConfig)
    by_lines = msgspec.structs.replace(
        estimator,
        measurement=(LASER,),
        regularization=GaussianKernel(scale=0.3),
        resampling=Systematic(only_when_moving=True),
    )
    scenario = world.scenario.changed(estimator=by_lines)
    return world._replace(scenario=scenario, maps=world.maps._replace(segments=line_map(seen, LineMapParams())))


def _stretch(settings: TurtlebotSettings, seed: int) -> Way:
    """Return a stretch of the log for an estimator whose maps have the walls."""
    way = played(Path(settings.log)).stretch(seed, settings.updates)
    return way._replace(maps=_walls(settings.log).maps)


def configured(world: World, case: Case, epochs: Sequence[Epoch], seed: int) -> LocalizationConfig:
    """Return the estimator of a case: the scenario's by lines alone, by lines and landmarks, or TURTLEBOT's own.

    TURTLEBOT's matches infinite lines regardless of the walls' extent, has no outliers and no tempering, and resamples
    at every update while the robot moves.
    """
    config = world.scenario.estimator
    assert isinstance(config, LocalizationConfig)
    lines = config.measurement[0]
    assert isinstance(lines, ScanLinesParams)
    tables: tuple[Any, ...] = config.measurement if case.filter == "landmarks" else (lines,)
    if case.filter == "document":
        printed = msgspec.structs.replace(lines.lines, sigma_along=None, outlier_fraction=0.0)
        tables = (msgspec.structs.replace(lines, lines=printed, hidden=None, tempering=1.0),)
        resampling = Systematic(when="always", only_when_moving=True)
        config = msgspec.structs.replace(config, resampling=resampling, regularization=None)
    known = known_start(epochs, seed, 0.2, 0.1)
    anywhere = UniformStart(clearance=0.18)
    starts = {
        "known": known,
        "uniform": anywhere,
        "heading": msgspec.structs.replace(anywhere, theta=known.theta),
        "readings": FromReadingsStart(candidates=20, base=anywhere),
    }
    return msgspec.structs.replace(config, n=case.n, measurement=tables, start=starts[case.start])


def _run(part: Part) -> list[Sample]:
    settings = part.settings
    if settings.log:
        world = _walls(settings.log)
        return _samples(part, world, {"drive": _stretch(settings, part.seed)})
    world = load_world(part.world)
    doors = tuple(Door(segment=segment, open_for=0.0) for segment in PANELS[part.world])
    ways = {
        "drive": record(world, part.seed, settings.updates),
        "panels": record(world, part.seed, settings.updates, panels=doors),
    }
    samples = _samples(part, world, ways)
    for name, robot in (("wheels", _without_gyro(world)), ("gyro", world)):
        epochs = record(robot, part.seed, settings.loops).epochs
        factors = _factors(world, Case("drive", "known", "careful", 0)) | {"case": "odometry", "filter": name}
        samples.append(Sample(factors, measures(epochs, dead_reckoning(epochs), whole=True)))
    return samples


def _samples(part: Part, world: World, ways: dict[str, Way]) -> list[Sample]:
    samples = []
    for case in part.cases:
        way = ways[case.case]
        track = follow(way, configured(world, case, way.epochs, part.seed))
        samples.append(Sample(_factors(world, case), measures(way.epochs, track.poses)))
    return samples


def _without_gyro(world: World) -> World:
    sensors = world.scenario.sensors
    assert isinstance(sensors, SimulatedSensorsConfig)
    assert sensors.odometry is not None
    wheels = msgspec.structs.replace(sensors, odometry=msgspec.structs.replace(sensors.odometry, gyro=None))
    return world._replace(scenario=world.scenario.changed(sensors=wheels))


def _factors(world: World, case: Case) -> dict[str, str | int]:
    return {
        "dataset": world.name,
        "case": case.case,
        "start": case.start,
        "filter": case.filter,
        "n": case.n,
    }


def _figures(settings: TurtlebotSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    written = []
    for name in (settings.log,) if settings.log else settings.worlds:
        world = _walls(name) if settings.log else load_world(name)
        way = _stretch(settings, seed) if settings.log else record(world, seed, settings.updates)
        starts: tuple[tuple[Start, int], ...] = (("readings", 2000), ("heading", 2000), ("known", 500))
        shown = []
        for start, n in starts:
            config = configured(world, Case("drive", start, "careful", n), way.epochs, seed)
            shown.append(Shown(f"{start} start, N = {n}", follow(way, config, shown=True)))
        own = folder / world.name
        own.mkdir(exist_ok=True)
        here = [row for row in rows if row["dataset"] == world.name]
        written += draw(world, way.epochs, shown, here, own)
    return written


STUDY = Study(
    about="TURTLEBOT: how many particles find a robot by the lines of a depth camera, from several starts",
    trials=20,
    settings=TurtlebotSettings,
    tasks=_parts,
    run_task=_run,
    rows=summarized,
    columns=SEARCH_COLUMNS,
    figures=_figures,
)
