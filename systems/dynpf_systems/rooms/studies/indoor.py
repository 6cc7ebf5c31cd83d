"""INDOOR: the number of particles needed in a furnished flat with people and doors, or on a real log."""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_protocol.errors import UsageError
from msgspec import Meta

from dynpf.filters.adaptation import KldParams, SensorResettingParams
from dynpf.filters.resampling import Systematic
from dynpf.filters.start import FromReadingsStart, UniformStart
from dynpf.measurement.beam import BeamParams
from dynpf.measurement.beam_fit import BeamFit
from dynpf.rng import generator
from dynpf.types import Count
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.studies.beam_fit import fit_scans
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

__all__ = ["STUDY", "IndoorSettings", "configured", "fitted"]

Start = Literal["known", "uniform", "readings"]
Filter = Literal["document", "careful", "kld", "resetting"]

FIT_SEED = 1_000_003
"""Seed of the drive to which the beam model is fitted; no trial uses it."""
WRONG = (1.5, 0.5)
"""Error of the given start pose in the case ``wrong``, m and rad."""
SPACING = 0.15
"""Spacing of particles, m, which adds to the sensor's noise in the beam model."""
MARGIN = 0.3
"""Difference of a beam's log-likelihood between tracking and the onset of resetting."""


class IndoorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The particle counts, the length of a drive, and a log to use instead of the simulated flat."""

    n: tuple[Count, ...] = (50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000)
    n_known: Count = 5000  # the most for a known start
    n_readings: Count = 5000  # the most for a start from readings
    n_deprived: Count = 1000  # for the case wrong
    updates: Annotated[int, Meta(ge=20)] = 60
    log: str = ""  # an imported log with scans, its map and a reference, instead of the flat


class Case(NamedTuple):
    """A filter's configuration on a drive."""

    case: Literal["drive", "wrong"]
    start: Start
    filter: Filter
    n: int


class Part(NamedTuple):
    """All cases of one drive, so that the drive is simulated once."""

    settings: IndoorSettings
    seed: int
    cases: tuple[Case, ...]


def _cases(settings: IndoorSettings) -> Iterator[Case]:
    for n in settings.n:
        if n <= settings.n_known:
            yield Case("drive", "known", "careful", n)
        yield Case("drive", "uniform", "document", n)
        yield Case("drive", "uniform", "careful", n)
        if n <= settings.n_readings:
            yield Case("drive", "readings", "careful", n)
    most = min(settings.n_readings, max(settings.n))
    yield Case("drive", "readings", "kld", most)
    n = settings.n_deprived
    yield Case("wrong", "known", "careful", n)
    yield Case("wrong", "known", "resetting", n)


def _parts(settings: IndoorSettings, trials: int, seed: int) -> list[Part]:
    return [Part(settings, seed + trial, tuple(_cases(settings))) for trial in range(trials)]


def world_of(settings: IndoorSettings) -> World:
    """Return the world of the study: that of its log, or the simulated flat."""
    return played(Path(settings.log)).world if settings.log else load_world("indoor-global")


def way_of(settings: IndoorSettings, seed: int) -> Way:
    """Return the drive of a seed: a stretch of the log, or a simulated drive."""
    if settings.log:
        return played(Path(settings.log)).stretch(seed, settings.updates)
    return record(load_world("indoor-global"), seed, settings.updates)


@lru_cache(maxsize=2)
def fitted(settings: IndoorSettings) -> BeamFit:
    """Return the beam model fitted to a separate drive, by expectation maximization at the true poses.

    On a log every fifth scan is used; the trials are on the same log.
    """
    world = world_of(settings)
    grid = world.maps.grid
    if grid is None:
        raise UsageError("the study needs a grid map")
    epochs = played(Path(settings.log)).epochs[::5] if settings.log else way_of(settings, FIT_SEED).epochs
    taken = ((truth, scan.angles, scan.ranges) for truth, scan in scans(world, epochs))
    return fit_scans(grid, taken, world.scanner.range_max, _beam(world))


def _beam(world: World) -> BeamParams:
    """Return the scenario's beam model, or else a default, to start the fit."""
    estimator = world.scenario.estimator
    assert isinstance(estimator, LocalizationConfig)
    own = (table for table in estimator.measurement if isinstance(table, BeamParams))
    return next(own, BeamParams(max_beams=30, tempering=0.3))


def configured(world: World, fit: BeamFit, case: Case, epochs: Sequence[Epoch], seed: int) -> LocalizationConfig:
    """Return the estimator of a case: the scenario's with the fitted beam model, or, for "document", INDOOR's own.

    INDOOR's uses the fit unchanged, without tempering, and systematic resampling at every update. The others add the
    distance between particles to the noise. "resetting" draws new particles where the readings are less likely than the
    fit predicts.
    """
    config = world.scenario.estimator
    beam = msgspec.structs.replace(fit.params, sigma_hit=math.hypot(fit.params.sigma_hit, SPACING))
    assert isinstance(config, LocalizationConfig)
    anywhere = UniformStart(clearance=0.18)
    by_readings = FromReadingsStart(candidates=20, base=anywhere)
    if case.filter == "document":
        beam = msgspec.structs.replace(fit.params, tempering=1.0)
        config = msgspec.structs.replace(config, resampling=Systematic(when="always"))
    if case.filter == "kld":
        config = msgspec.structs.replace(
            config, adaptation=(KldParams(cell_x=0.2, cell_y=0.2, n_min=min(200, case.n), n_max=case.n),)
        )
    if case.filter == "resetting":
        usual = beam.tempering * fit.log_likelihoods[-1] / fit.used
        reset = SensorResettingParams(log_likelihood=float(usual) - MARGIN * beam.tempering, share_max=0.1)
        config = msgspec.structs.replace(config, adaptation=(reset,), restart=by_readings)
    known = known_start(epochs, seed, 0.2, 0.1)
    if case.case == "wrong":
        aside = generator(seed, "studies", 0, "wrong").uniform(-math.pi, math.pi)
        x, y = known.x + WRONG[0] * math.cos(aside), known.y + WRONG[0] * math.sin(aside)
        known = msgspec.structs.replace(known, x=x, y=y, theta=known.theta + WRONG[1])
    starts = {"known": known, "uniform": anywhere, "readings": by_readings}
    return msgspec.structs.replace(config, n=case.n, measurement=(beam,), start=starts[case.start])


def _run(part: Part) -> list[Sample]:
    settings = part.settings
    world = world_of(settings)
    fit = fitted(settings)
    samples = []
    way = way_of(settings, part.seed)
    for case in part.cases:
        track = follow(way, configured(world, fit, case, way.epochs, part.seed))
        found = measures(way.epochs, track.poses)
        samples.append(Sample(_factors(world, case), found | {"particles": float(np.nanmean(track.counts))}))
    known = Case("drive", "known", "careful", 0)
    factors = _factors(world, known) | {"filter": "odometry"}
    samples.append(Sample(factors, measures(way.epochs, dead_reckoning(way.epochs))))
    values = {name: float(getattr(fit.params, name)) for name in _FITTED}
    samples.append(Sample(_factors(world, known) | {"case": "fit", "filter": "em"}, values))
    return samples


_FITTED = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")


def _factors(world: World, case: Case) -> dict[str, str | int]:
    return {
        "dataset": world.name,
        "case": case.case,
        "start": case.start,
        "filter": case.filter,
        "n": case.n,
    }


def _figures(settings: IndoorSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    world, way, fit = world_of(settings), way_of(settings, seed), fitted(settings)
    shown = []
    starts: tuple[tuple[Start, int], ...] = (("readings", 1000), ("known", 1000))
    for start, n in starts:
        case = Case("drive", start, "careful", n)
        config = configured(world, fit, case, way.epochs, seed)
        shown.append(Shown(f"{start} start, N = {n}", follow(way, config, shown=True)))
    return draw(world, way.epochs, shown, rows, folder)


STUDY = Study(
    about="INDOOR: how many particles a furnished flat with people and doors calls for; deprivation, and its cure",
    trials=20,
    settings=IndoorSettings,
    tasks=_parts,
    run_task=_run,
    rows=summarized,
    columns=(
        *SEARCH_COLUMNS,
        ("particles", ".0f", "particles_mean"),
        ("hit/short/max/rand", ".3f", "z_hit_mean z_short_mean z_max_mean z_rand_mean"),
        ("sigma m, lambda /m", ".3f", "sigma_hit_mean lambda_short_mean"),
    ),
    figures=_figures,
)
