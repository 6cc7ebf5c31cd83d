"""PARTS's simulations: three and six parts under noise, the Cramer-Rao bound, and what a step costs."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
from dynpf_systems.parts.config import FilterName, RearrangementConfig
from dynpf_systems.parts.robot_filters import Seen, fused, robot_filter
from msgspec import Meta

from dynpf.metrics.consistency import nees
from dynpf.metrics.quantiles import chi_square_quantile
from dynpf.metrics.rearrangement import bound_ratio, packing_density, robot_bound
from dynpf.rng import Stream, generator
from dynpf_lab.studies.parts import (
    LAYOUTS,
    NOISE,
    PROCESS,
    RADII,
    SETTLED,
    Conditions,
    FloatArray,
    PartsRun,
    Record,
    layout_task,
    measured,
    record_parts,
)
from dynpf_lab.studies.parts_figures import draw_bounds, draw_measures, draw_times
from dynpf_lab.studies.rows import Row, Sample, summarized
from dynpf_lab.studies.study import Study

__all__ = ["STUDIES", "run_seed"]

Goals = Literal["E", "I", "H"]
Noise = Literal["none", "low", "medium", "high"]
Noisy = Literal["low", "medium", "high"]
Count = Annotated[int, Meta(ge=1)]
Parts = Literal[3, 6]

GAUSSIAN = ("extended_kalman", "unscented_kalman")
APART = 20
"""Ticks between instants whose errors count as independent."""

FIGURE_RUNS = 20
"""Runs over which the figure of the bound over time is drawn, as PARTS's."""

PRINTED_COLLIDED = {
    ("low", 0): (0, 30, 50),
    ("low", 49): (0, 10, 30),
    ("low", 100): (0, 10, 20),
    ("low", 225): (0, 0, 10),
    ("medium", 0): (0, 50, 60),
    ("medium", 49): (0, 10, 30),
    ("medium", 100): (0, 10, 20),
    ("medium", 225): (0, 0, 10),
    ("high", 0): (10, 70, 70),
    ("high", 49): (0, 20, 40),
    ("high", 100): (0, 20, 30),
    ("high", 225): (0, 10, 20),
}
"""PARTS, Table 4.2: collisions with six parts in % of 10 runs, easy, intermediate and hard."""
PRINTED_MS = {
    ("mate", 49): 40,
    ("mate", 100): 72,
    ("mate", 225): 150,
    ("move", 49): 90,
    ("move", 100): 173,
    ("move", 225): 380,
}
"""PARTS, Table 4.3: time of a step of the particle filter in ms."""


class TaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    goals: tuple[Goals, ...] = ("E", "I", "H")
    noises: tuple[Noise, ...] = ("none", "low", "medium", "high")
    n: tuple[Annotated[int, Meta(ge=0)], ...] = (0, 49, 100, 225)  # 0: no filter
    filters: tuple[FilterName, ...] = ("optimal",)
    ticks: Count = 4000  # after which a run is given up; one that is completed takes 500 to 1400


class BoundsSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    parts: tuple[Parts, ...] = (3, 6)
    goals: tuple[Goals, ...] = ("E", "I", "H")
    noises: tuple[Noisy, ...] = ("low", "medium", "high")
    n: Count = 100
    filters: tuple[FilterName, ...] = ("optimal",)
    ticks: Annotated[int, Meta(gt=SETTLED)] = 400  # of each run, from its start


class TimeSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    parts: Parts = 6
    goals: Goals = "H"
    noise: Noisy = "medium"
    n: tuple[Count, ...] = (49, 100, 225)


class _Start(NamedTuple):
    """All runs of one trial with one layout of goals: ``settings`` says which."""

    layout: str
    seed: int
    trial: int
    settings: Any

    @property
    def factors(self) -> dict[str, int | str]:
        return {"parts": int(self.layout[0]), "goals": self.layout[1]}


def run_seed(seed: int, cell: str, trial: int) -> int:
    """Return the seed of a trial's runs in a cell of the study, whatever the filter."""
    return int(generator(seed, cell, trial).integers(2**62))


# parts-3 and parts-6.


def _task_parts(count: int) -> Callable[[TaskSettings, int, int], list[_Start]]:
    return lambda settings, trials, seed: [
        _Start(f"{count}{goals}", seed, trial, settings) for trial in range(trials) for goals in settings.goals
    ]


def _run_start(start: _Start) -> list[Sample]:
    """Return a sample for each noise and filter; what is normalized is so by the run without noise."""
    settings: TaskSettings = start.settings
    task = layout_task(start.layout)
    seed = run_seed(start.seed, start.layout, start.trial)
    perfect = measured(record_parts(task, seed, Conditions(max_ticks=settings.ticks)))
    samples = []
    for noise in settings.noises:
        for n, name in [(0, None)] if noise == "none" else _filters(settings):
            run = perfect
            if noise != "none":
                # The number of particles is nothing to a Kalman filter, nor the filter's name to raw measurements.
                particles = 0 if name is None else n or 1
                conditions = Conditions(NOISE[noise], particles, name or "optimal", max_ticks=settings.ticks)
                run = measured(record_parts(task, seed, conditions))
            factors = {**start.factors, "noise": noise, "n": n, "filter": name or "none"}
            samples.append(Sample(factors, _measures(run, perfect)))
    return samples


def _filters(settings: TaskSettings) -> list[tuple[int, FilterName | None]]:
    """Return the numbers of particles and the filters to be run; none with zero particles is no filter."""
    chosen: list[tuple[int, FilterName | None]] = [(0, None)] if 0 in settings.n else []
    chosen += [(0, name) for name in settings.filters if name in GAUSSIAN]
    return chosen + [(n, name) for name in settings.filters if name not in GAUSSIAN for n in settings.n if n]


def _measures(run: PartsRun, perfect: PartsRun) -> dict[str, float | bool]:
    return {
        "completed_percent": run.completed,
        "collided_percent": run.collided,
        "succeeded_percent": run.completed and not run.collided,
        "npl": run.npl,
        "nrl": run.nrl,
        "pi": run.pi,
        "npl_normalized": run.npl / perfect.npl,
        "nrl_normalized": run.nrl / perfect.nrl,
        "pi_normalized": run.pi / perfect.pi,
        "final_error_cm": 100.0 * run.final_error,
        "rpee_cm": 100.0 * run.rpee,
        "ppee_cm": 100.0 * run.ppee,
        "crlb_ratio": run.crlb_ratio,
        "nees": run.nees,
        "kurtosis": run.kurtosis,
        "snr_db": run.snr_db,
    }


def _task_rows(samples: list[Sample]) -> list[Row]:
    rows = summarized(samples, "goals")
    for row in rows:
        if row["goals"] == "all":
            continue
        row["comp"] = _comp(f"{row['parts']}{row['goals']}")
        printed = PRINTED_COLLIDED.get((row["noise"], row["n"]))
        if printed is not None and row["parts"] == 6 and row["filter"] in {"none", "optimal"}:
            row["printed_collided_percent"] = printed["EIH".index(row["goals"])]
    return rows


def _comp(layout: str) -> float:
    goals = LAYOUTS[layout]
    return packing_density(np.array(goals), np.array(RADII[len(goals)]))


# parts-bounds.


def _bounds_parts(settings: BoundsSettings, trials: int, seed: int) -> list[_Start]:
    return [
        _Start(f"{parts}{goals}", seed, trial, settings)
        for parts in settings.parts
        for trial in range(trials)
        for goals in settings.goals
    ]


def _run_bounds(start: _Start) -> list[Sample]:
    settings: BoundsSettings = start.settings
    samples = []
    for noise in settings.noises:
        # Other noise in each cell: so the rows of a study are independent of one another.
        seed = run_seed(start.seed, f"{start.layout} {noise}", start.trial)
        for name in settings.filters:
            conditions = Conditions(NOISE[noise], settings.n, name, max_ticks=settings.ticks)
            record = record_parts(layout_task(start.layout), seed, conditions)
            factors = {
                **start.factors,
                "noise": noise,
                "n": 0 if name in GAUSSIAN else settings.n,
                "filter": name,
            }
            samples += [Sample(factors | {"stage": stage}, measures) for stage, measures in _stages(record).items()]
    return samples


def _stages(record: Record) -> dict[str, dict[str, float | bool]]:
    """Return what the settled filter does while the robot is alone, with a part in its gripper, and all the time."""
    errors = np.linalg.norm(record.errors, axis=1)
    bound = robot_bound(record.information, record.process_variance)
    squares = nees(record.errors.T, record.covariances)
    settled = np.arange(errors.size) >= SETTLED
    apart = np.arange(errors.size) % APART == 0
    stages = {"mate": settled & (record.held < 0), "move": settled & (record.held >= 0), "all": settled}
    return {
        stage: {
            "rms_error_cm": 100.0 * _rms(errors[chosen]),
            "bound_cm": 100.0 * _rms(bound.noisy[chosen]),
            "bound_noiseless_cm": 100.0 * _rms(bound.noiseless[chosen]),
            "crlb_ratio": bound_ratio(errors[chosen], bound.noisy[chosen]),
            "nees": float(np.mean(squares[chosen & apart])) if (chosen & apart).any() else math.nan,
            "instants": float(np.sum(chosen & apart)),
        }
        for stage, chosen in stages.items()
        if chosen.any()
    }


def _bounds_rows(samples: list[Sample]) -> list[Row]:
    """Summarize, and put beside NEES, over all instants of all runs, the band that holds it if the filter is honest."""
    rows = summarized(samples, "goals")
    for row in rows:
        group = [measures for measures in _of_row(row, samples) if not math.isnan(measures["nees"])]
        instants = sum(measures["instants"] for measures in group)
        if instants:
            row["nees_mean"] = sum(measures["nees"] * measures["instants"] for measures in group) / instants
            row["nees_low"], row["nees_high"] = (
                chi_square_quantile(place, 2.0 * instants) / instants for place in (0.025, 0.975)
            )
        for suffix in ("mean", "median", "p95", "ci_low", "ci_high"):
            row.pop(f"instants_{suffix}", None)
    return rows


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


# parts-time.


def _time_parts(settings: TimeSettings, trials: int, seed: int) -> list[tuple[TimeSettings, int, int]]:
    """Return one task: two that run side by side would disturb each other's times."""
    return [(settings, trials, seed)]


def _run_times(task: tuple[TimeSettings, int, int]) -> list[Sample]:
    """Return a sample for each step of the estimator and the controller, and for each of the filter by itself."""
    settings, trials, seed = task
    layout = layout_task(f"{settings.parts}{settings.goals}")
    variance = NOISE[settings.noise]
    samples = []
    for n in settings.n:
        record_parts(layout, seed, Conditions(variance, n, max_ticks=40))  # warms up
        common = {"parts": settings.parts, "goals": settings.goals, "noise": settings.noise, "n": n}
        for stage in ("mate", "move"):
            factors = {**common, "filter": "optimal", "stage": stage}
            samples += [
                Sample(factors, {"filter_ms": spent, "estimator_ms": math.nan, "controller_ms": math.nan})
                for spent in _filter_times(n, variance, held=stage == "move")
            ]
        for trial in range(trials):
            record = record_parts(layout, run_seed(seed, settings.goals, trial), Conditions(variance, n))
            for held, mode, (estimator, controller) in zip(record.held, record.modes, record.seconds, strict=True):
                stage = "move" if held >= 0 else "mate"
                if mode == "idle" and held < 0:
                    continue
                times = {"filter_ms": math.nan, "estimator_ms": 1e3 * estimator, "controller_ms": 1e3 * controller}
                samples += [Sample({**common, "filter": "optimal", "stage": where}, times) for where in (stage, "all")]
    return samples


def _filter_times(n: int, variance: float, *, held: bool, steps: int = 400) -> list[float]:
    """Return the times in ms of steps of the robot's filter by itself, with one disc in view or two."""
    particles = robot_filter(RearrangementConfig(n=n, measurement_variance=variance))
    sight = Seen(np.zeros(2), variance)
    belief = particles.start(sight, Stream.of(0, "time", 0))
    times = []
    for step in range(steps):
        stream = Stream.of(0, "time", step, "robot")
        begun = time.perf_counter()
        seen = fused([sight, sight] if held else [sight])
        belief = particles.step(belief, np.zeros(2), PROCESS, seen, stream)
        times.append(1e3 * (time.perf_counter() - begun))
    return times


def _time_rows(samples: list[Sample]) -> list[Row]:
    rows = [row for row in summarized(samples, "goals") if row["goals"] != "all"]
    for row in rows:
        row["printed_filter_ms"] = PRINTED_MS.get((row["stage"], row["n"]))
        for name in ("filter_ms", "estimator_ms", "controller_ms"):
            values = [measures[name] for measures in _of_row(row, samples)]
            if not np.isnan(values).all():
                row[f"{name}_best"] = float(np.nanmin(values))
                row[f"{name}_p99"] = float(np.nanquantile(values, 0.99))
    return rows


def _of_row(row: Row, samples: list[Sample]) -> list[dict[str, float | bool]]:
    """Return what the samples measured that a row sums up: those under its factors, of any goals where it says all."""
    factors = [name for name in samples[0].factors if (name, row[name]) != ("goals", "all")]
    return [one.measures for one in samples if all(row[name] == one.factors[name] for name in factors)]


# The studies.


def _task_figures(count: int) -> Callable[[TaskSettings, int, list[Row], Path], list[Path]]:
    def figures(settings: TaskSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
        runs: dict[str, list[Record]] = {
            goals: [
                record_parts(
                    layout_task(f"{count}{goals}"), run_seed(seed, f"{count}{goals}", 0), Conditions(NOISE["high"], n)
                )
                for n in (0, 100)
            ]
            for goals in settings.goals
        }
        return draw_measures(rows, runs, folder)

    return figures


def _bounds_figures(settings: BoundsSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    """Draw the bounds over time for the first number of parts and the last goals."""
    layout = f"{settings.parts[0]}{settings.goals[-1]}"
    runs: dict[str, list[Record]] = {}
    for noise in settings.noises:
        conditions = Conditions(NOISE[noise], settings.n, settings.filters[0], max_ticks=settings.ticks)
        runs[noise] = [
            record_parts(layout_task(layout), run_seed(seed, f"{layout} {noise}", trial), conditions)
            for trial in range(FIGURE_RUNS)
        ]
    return draw_bounds(rows, runs, folder)


_FACTORS = (
    ("parts", "", "parts"),
    ("goals", "", "goals"),
    ("noise", "", "noise"),
    ("n", "", "n"),
    ("filter", "", "filter"),
)
_TIMES = "{0}_ms_best {0}_ms_median {0}_ms_p99"
_INTERVAL = "{0} {0}_ci_low {0}_ci_high"
_TASK_COLUMNS = (
    *_FACTORS,
    ("trials", "", "trials"),
    ("completed %", ".0f", "completed_percent"),
    ("collided % (95 %)", ".0f", _INTERVAL.format("collided_percent")),
    ("printed", "", "printed_collided_percent"),
    ("npl", ".3f", "npl_mean"),
    ("nrl", ".3f", "nrl_mean"),
    ("pi", ".3f", "pi_mean"),
    ("npl / nrl / pi over noise-free", ".2f", "npl_normalized_mean nrl_normalized_mean pi_normalized_mean"),
    ("final cm", ".2f", "final_error_cm_mean"),
    ("rpee / ppee cm", ".2f", "rpee_cm_mean ppee_cm_mean"),
    ("RMS/bound", ".3f", "crlb_ratio_mean"),
    ("NEES", ".2f", "nees_mean"),
    ("kurtosis", ".2f", "kurtosis_mean"),
    ("SNR dB", ".1f", "snr_db_mean"),
)


def _task_study(about: str, count: int) -> Study:
    parts, figures = _task_parts(count), _task_figures(count)
    return Study(about, 10, TaskSettings, parts, _run_start, _task_rows, _TASK_COLUMNS, figures)


STUDIES = {
    "parts-3": _task_study("PARTS's figures 4.2 to 4.4: three parts, three layouts of goals, noise, and filters", 3),
    "parts-6": _task_study("PARTS's figures 4.9 to 4.11 and Table 4.2: the same with six parts", 6),
    "parts-bounds": Study(
        "PARTS's figures 4.5 to 4.7 and 4.12 to 4.14: the robot's error against its Cramer-Rao bound",
        20,
        BoundsSettings,
        _bounds_parts,
        _run_bounds,
        _bounds_rows,
        (
            *_FACTORS,
            ("stage", "", "stage"),
            ("trials", "", "trials"),
            ("RMS cm", ".3f", "rms_error_cm_mean"),
            ("bound cm", ".3f", "bound_cm_mean"),
            ("noise-free motion", ".3f", "bound_noiseless_cm_mean"),
            ("RMS/bound (95 %)", ".3f", "crlb_ratio_mean crlb_ratio_ci_low crlb_ratio_ci_high"),
            ("NEES", ".2f", "nees_mean"),
            ("band", ".2f", "nees_low nees_high"),
        ),
        _bounds_figures,
    ),
    "parts-time": Study(
        "PARTS's Table 4.3: what a step of the filter costs, and one of the controller",
        3,
        TimeSettings,
        _time_parts,
        _run_times,
        _time_rows,
        (
            *_FACTORS,
            ("stage", "", "stage"),
            ("steps", "", "trials"),
            ("filter ms: best / median / 99 %", ".3f", _TIMES.format("filter")),
            ("printed", ".0f", "printed_filter_ms"),
            ("estimator", ".3f", _TIMES.format("estimator")),
            ("controller", ".3f", _TIMES.format("controller")),
        ),
        lambda _settings, _seed, rows, folder: draw_times(rows, folder),
    ),
}
