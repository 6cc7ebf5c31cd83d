"""PARTS's figures of the Cramer-Rao bound: the error of the robot's filter against it."""

import math
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from msgspec import Meta

from dynpf.metrics.consistency import nees
from dynpf.metrics.quantiles import chi_square_quantile
from dynpf.metrics.rearrangement import bound_ratio, robot_bound
from dynpf.types import Count, FloatArray
from dynpf_systems.parts.config import FilterName
from dynpf_systems.parts.measures import Course
from dynpf_systems.parts.studies.figures import draw_bounds
from dynpf_systems.parts.studies.runs import Conditions, layout_task, run_parts
from dynpf_systems.parts.studies.trials import FACTOR_COLUMNS, GAUSSIAN, Goals, Parts, Start, run_seed, samples_of
from dynpf_systems.parts.task import NOISE, NoisyLevel

__all__ = ["STUDY", "BoundsSettings"]

APART = 20
"""Ticks between instants whose errors count as independent."""

FIGURE_RUNS = 20
"""Number of runs in the figure of the bound over time, as in PARTS."""


class BoundsSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The layouts, the noise levels, the filters, and the length of a run."""

    parts: tuple[Parts, ...] = (3, 6)
    goals: tuple[Goals, ...] = ("E", "I", "H")
    noises: tuple[NoisyLevel, ...] = get_args(NoisyLevel)
    n: Count = 100
    filters: tuple[FilterName, ...] = ("optimal",)
    ticks: Annotated[int, Meta(gt=20)] = 400  # of each run


def _bounds_parts(settings: BoundsSettings, trials: int, seed: int) -> list[Start]:
    return [
        Start(f"{parts}{goals}", seed, trial, settings)
        for parts in settings.parts
        for trial in range(trials)
        for goals in settings.goals
    ]


def _run_bounds(start: Start) -> list[Sample]:
    settings: BoundsSettings = start.settings
    samples = []
    for noise in settings.noises:
        # Each cell has its own noise, so that the rows of a study are independent.
        seed = run_seed(start.seed, f"{start.layout} {noise}", start.trial)
        for name in settings.filters:
            conditions = Conditions(NOISE[noise].measurement, settings.n, name, max_ticks=settings.ticks)
            course = run_parts(layout_task(start.layout), seed, conditions)
            factors = {
                **start.factors,
                "noise": noise,
                "n": 0 if name in GAUSSIAN else settings.n,
                "filter": name,
            }
            samples += [Sample(factors | {"stage": stage}, measures) for stage, measures in _stages(course).items()]
    return samples


def _stages(course: Course) -> dict[str, dict[str, float | bool]]:
    """Return the measures of the settled filter with an empty gripper, with a held part, and over all ticks."""
    errors = np.linalg.norm(course.errors, axis=1)
    bound = robot_bound(course.information, course.noise.process)
    squares = nees(course.errors.T, course.covariances)
    settled = np.arange(errors.size) >= course.settled.start
    apart = np.arange(errors.size) % APART == 0
    stages = {"mate": settled & (course.held < 0), "move": settled & (course.held >= 0), "all": settled}
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
    """Summarize; add the NEES over all instants of all runs, and its 95 % band for a consistent filter."""
    rows = summarized(samples, "goals")
    for row in rows:
        group = [measures for measures in samples_of(row, samples) if not math.isnan(measures["nees"])]
        instants = sum(measures["instants"] for measures in group)
        if instants:
            row["nees_mean"] = sum(measures["nees"] * measures["instants"] for measures in group) / instants
            row["nees_low"], row["nees_high"] = (
                chi_square_quantile(probability, 2.0 * instants) / instants for probability in (0.025, 0.975)
            )
        for suffix in ("mean", "median", "p95", "ci_low", "ci_high"):
            row.pop(f"instants_{suffix}", None)
    return rows


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _figures(settings: BoundsSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    """Draw the bounds over time for the first number of parts and the last goals."""
    layout = f"{settings.parts[0]}{settings.goals[-1]}"
    runs: dict[str, list[Course]] = {}
    for noise in settings.noises:
        conditions = Conditions(NOISE[noise].measurement, settings.n, settings.filters[0], max_ticks=settings.ticks)
        runs[noise] = [
            run_parts(layout_task(layout), run_seed(seed, f"{layout} {noise}", trial), conditions)
            for trial in range(FIGURE_RUNS)
        ]
    return draw_bounds(rows, runs, folder)


STUDY = Study(
    about="PARTS's figures 4.5 to 4.7 and 4.12 to 4.14: the robot's error against its Cramer-Rao bound",
    trials=20,
    settings=BoundsSettings,
    tasks=_bounds_parts,
    run_task=_run_bounds,
    rows=_bounds_rows,
    columns=(
        *FACTOR_COLUMNS,
        ("stage", "", "stage"),
        ("trials", "", "trials"),
        ("RMS cm", ".3f", "rms_error_cm_mean"),
        ("bound cm", ".3f", "bound_cm_mean"),
        ("noise-free motion", ".3f", "bound_noiseless_cm_mean"),
        ("RMS/bound (95 %)", ".3f", "crlb_ratio_mean crlb_ratio_ci_low crlb_ratio_ci_high"),
        ("NEES", ".2f", "nees_mean"),
        ("band", ".2f", "nees_low nees_high"),
    ),
    figures=_figures,
)
