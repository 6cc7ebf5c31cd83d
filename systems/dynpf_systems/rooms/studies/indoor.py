"""INDOOR's question: how many particles does it take in a furnished flat with people and doors, or on a real log?"""

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
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.studies.beam_fit import fit_scans
from dynpf_systems.rooms.studies.figures import Shown, draw
from dynpf_systems.rooms.studies.ways import (
    Epoch,
    Way,
    World,
    dead_reckoning,
    follow,
    known_start,
    measures,
    played,
    record,
    scans,
    world,
)

__all__ = ["STUDY", "IndoorSettings", "configured", "fitted"]

Count = Annotated[int, Meta(ge=1)]
Start = Literal["known", "uniform", "readings"]
Filter = Literal["document", "careful", "kld", "resetting"]

FIT_SEED = 1_000_003
"""Of the drive that the beam model is fitted to; no trial has it."""
WRONG = (1.5, 0.5)
"""How far off the pose told is in the case ``wrong``, m, and rad."""
SPACING = 0.15
"""m that particles are apart: a wall's error as far as they can tell, besides the sensor's own."""
MARGIN = 0.3
"""Of a beam's log-likelihood, on the track and while resetting begins."""


class IndoorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    n: tuple[Count, ...] = (50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000)
    n_known: Count = 5000  # the most for a known start
    n_readings: Count = 5000  # the most for a start from readings
    n_deprived: Count = 1000  # for the case wrong
    updates: Annotated[int, Meta(ge=20)] = 60
    log: str = ""  # an imported log with scans, its map and a reference, in place of the flat


class Case(NamedTuple):
    """One filter on one drive: what is asked of it."""

    case: Literal["drive", "wrong"]
    start: Start
    filter: Filter
    n: int


class Part(NamedTuple):
    """All that is tried on one drive, so that it takes place once."""

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


def place_of(settings: IndoorSettings) -> World:
    return played(Path(settings.log)).place if settings.log else world("indoor-global")


def way_of(settings: IndoorSettings, seed: int) -> Way:
    if settings.log:
        return played(Path(settings.log)).stretch(seed, settings.updates)
    return record(world("indoor-global"), seed, settings.updates)


@lru_cache(maxsize=2)
def fitted(settings: IndoorSettings) -> BeamFit:
    """Return the beam model of a drive of its own, by expectation maximization over its readings at the true poses.

    Of a log, every fifth scan takes part; the trials are on the same log.
    """
    place = place_of(settings)
    grid = place.maps.grid
    if grid is None:
        raise UsageError("the study needs a grid map")
    epochs = played(Path(settings.log)).epochs[::5] if settings.log else way_of(settings, FIT_SEED).epochs
    taken = ((truth, scan.angles, scan.ranges) for truth, scan in scans(place, epochs))
    return fit_scans(grid, taken, place.scanner.range_max, _beam(place))


def _beam(place: World) -> BeamParams:
    """Return the scenario's beam model, or another to start with."""
    estimator = place.scenario.estimator
    assert isinstance(estimator, LocalizationConfig)
    own = (table for table in estimator.measurement if isinstance(table, BeamParams))
    return next(own, BeamParams(max_beams=30, tempering=0.3))


def configured(place: World, fit: BeamFit, case: Case, epochs: Sequence[Epoch], seed: int) -> LocalizationConfig:
    """Return the estimator of a case: the scenario's with the fitted beam model, or, for "document", INDOOR's own.

    That one takes the fit as it is, counts every beam in full, and resamples by a low-variance comb at every update.
    The others allow for the distance between particles. "resetting" draws particles anew where the readings are less
    likely than the fit says that they should be.
    """
    config = place.scenario.estimator
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
    place = place_of(settings)
    fit = fitted(settings)
    samples = []
    way = way_of(settings, part.seed)
    for case in part.cases:
        track = follow(way, configured(place, fit, case, way.epochs, part.seed))
        found = measures(way.epochs, track.poses)
        samples.append(Sample(_factors(place, case), found | {"particles": float(np.nanmean(track.counts))}))
    known = Case("drive", "known", "careful", 0)
    factors = _factors(place, known) | {"filter": "odometry"}
    samples.append(Sample(factors, measures(way.epochs, dead_reckoning(way.epochs))))
    values = {name: float(getattr(fit.params, name)) for name in _FITTED}
    samples.append(Sample(_factors(place, known) | {"case": "fit", "filter": "em"}, values))
    return samples


_FITTED = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")


def _factors(place: World, case: Case) -> dict[str, str | int]:
    return {
        "dataset": place.name,
        "case": case.case,
        "start": case.start,
        "filter": case.filter,
        "n": case.n,
    }


def _figures(settings: IndoorSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    place, way, fit = place_of(settings), way_of(settings, seed), fitted(settings)
    shown = []
    starts: tuple[tuple[Start, int], ...] = (("readings", 1000), ("known", 1000))
    for start, n in starts:
        case = Case("drive", start, "careful", n)
        config = configured(place, fit, case, way.epochs, seed)
        shown.append(Shown(f"{start} start, N = {n}", follow(way, config, shown=True)))
    return draw(place, way.epochs, shown, rows, folder)


STUDY = Study(
    about="INDOOR: how many particles a furnished flat with people and doors calls for; deprivation, and its cure",
    trials=20,
    settings=IndoorSettings,
    tasks=_parts,
    run_task=_run,
    rows=summarized,
    columns=(
        ("dataset", "", "dataset"),
        ("case", "", "case"),
        ("start", "", "start"),
        ("filter", "", "filter"),
        ("n", "", "n"),
        ("trials", "", "trials"),
        ("success %", ".0f", "success_percent"),
        ("95 %", ".0f", "success_percent_ci_low success_percent_ci_high"),
        ("updates", ".0f", "updates_to_converge_median"),
        ("position m", ".3f", "position_rmse_m_median position_rmse_m_p95"),
        ("heading rad", ".4f", "heading_rmse_rad_median"),
        ("particles", ".0f", "particles_mean"),
        ("hit/short/max/rand", ".3f", "z_hit_mean z_short_mean z_max_mean z_rand_mean"),
        ("sigma m, lambda /m", ".3f", "sigma_hit_mean lambda_short_mean"),
    ),
    figures=_figures,
)
