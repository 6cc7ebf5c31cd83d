"""PARTS's simulations: three and six parts, three layouts of goals, noise, and filters."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from msgspec import Meta

from dynpf.metrics.rearrangement import packing_density
from dynpf.types import Count
from dynpf_systems.parts.config import FilterName
from dynpf_systems.parts.measures import Course
from dynpf_systems.parts.studies.figures import draw_measures
from dynpf_systems.parts.studies.runs import LAYOUTS, RADII, Conditions, layout_task, measured, run_parts
from dynpf_systems.parts.studies.trials import FACTOR_COLUMNS, GAUSSIAN, Goals, Start, run_seed
from dynpf_systems.parts.task import NOISE, NoiseLevel, RearrangementTask

__all__ = ["SIX", "THREE", "TaskSettings"]

_LENGTHS = ("npl", "nrl", "pi")

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
"""PARTS, Table 4.2: runs with collisions with six parts, in % of 10 runs, for easy, intermediate and hard goals."""


class TaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The layouts of goals, the noise levels, the filters, and the length of a run."""

    goals: tuple[Goals, ...] = ("E", "I", "H")
    noises: tuple[NoiseLevel, ...] = get_args(NoiseLevel)
    n: tuple[Annotated[int, Meta(ge=0)], ...] = (0, 49, 100, 225)  # 0: no filter
    filters: tuple[FilterName, ...] = ("optimal",)
    ticks: Count = 4000  # after which a run is given up; a completed run takes 500 to 1400


def _task_parts(count: int) -> Callable[[TaskSettings, int, int], list[Start]]:
    return lambda settings, trials, seed: [
        Start(f"{count}{goals}", seed, trial, settings) for trial in range(trials) for goals in settings.goals
    ]


def _run_start(start: Start) -> list[Sample]:
    """Return a sample for each noise and filter; normalized measures are relative to the run without noise."""
    settings: TaskSettings = start.settings
    task = layout_task(start.layout)
    seed = run_seed(start.seed, start.layout, start.trial)
    perfect = _measured(task, seed, Conditions(max_ticks=settings.ticks))
    samples = []
    for noise in settings.noises:
        for n, name in [(0, None)] if noise == "none" else _filters(settings):
            run = perfect
            if noise != "none":
                # A Kalman filter ignores the number of particles, and raw measurements ignore the filter's name.
                particles = 0 if name is None else n or 1
                conditions = Conditions(
                    NOISE[noise].measurement, particles, name or "optimal", max_ticks=settings.ticks
                )
                run = _measured(task, seed, conditions)
            factors = {**start.factors, "noise": noise, "n": n, "filter": name or "none"}
            samples.append(Sample(factors, _measures(run, perfect)))
    return samples


def _filters(settings: TaskSettings) -> list[tuple[int, FilterName | None]]:
    """Return the numbers of particles with the filters to be run; the filter None is no filter."""
    chosen: list[tuple[int, FilterName | None]] = [(0, None)] if 0 in settings.n else []
    chosen += [(0, name) for name in settings.filters if name in GAUSSIAN]
    return chosen + [(n, name) for name in settings.filters if name not in GAUSSIAN for n in settings.n if n]


def _measured(task: RearrangementTask, seed: int, conditions: Conditions) -> dict[str, Any]:
    return measured(run_parts(task, seed, conditions), conditions)


def _measures(run: dict[str, Any], perfect: dict[str, Any]) -> dict[str, float | bool]:
    collided = run["collisions"] > 0
    return {
        "completed_25mm_percent": run["completed"],
        "collided_percent": collided,
        "succeeded_25mm_percent": run["completed"] and not collided,
        **{name: run[name] for name in _LENGTHS},
        **{f"{name}_normalized": run[name] / perfect[name] for name in _LENGTHS},
        "final_error_mean_cm": 100.0 * run["final_error_mean_m"],
        "final_error_max_cm": 100.0 * run["final_error_max_m"],
        "rpee_cm": 100.0 * run["rpee_m"],
        "ppee_cm": 100.0 * run["ppee_m"],
        **{name: run.get(name, math.nan) for name in ("crlb_ratio", "robot_nees", "kurtosis", "snr_db")},
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


def _figures(count: int) -> Callable[[TaskSettings, int, list[Row], Path], list[Path]]:
    def figures(settings: TaskSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
        """Draw the measures, and runs of each layout with and without a filter."""
        runs: dict[str, list[Course]] = {
            goals: [
                run_parts(
                    layout_task(f"{count}{goals}"),
                    run_seed(seed, f"{count}{goals}", 0),
                    Conditions(NOISE["high"].measurement, n),
                )
                for n in (0, 100)
            ]
            for goals in settings.goals
        }
        return draw_measures(rows, runs, folder)

    return figures


_INTERVAL = "{0} {0}_ci_low {0}_ci_high"
_TASK_COLUMNS = (
    *FACTOR_COLUMNS,
    ("trials", "", "trials"),
    ("completed %", ".0f", "completed_25mm_percent"),
    ("collided % (95 %)", ".0f", _INTERVAL.format("collided_percent")),
    ("printed", "", "printed_collided_percent"),
    ("npl", ".3f", "npl_mean"),
    ("nrl", ".3f", "nrl_mean"),
    ("pi", ".3f", "pi_mean"),
    ("npl / nrl / pi over noise-free", ".2f", "npl_normalized_mean nrl_normalized_mean pi_normalized_mean"),
    ("final cm: mean / max", ".2f", "final_error_mean_cm_mean final_error_max_cm_mean"),
    ("rpee / ppee cm", ".2f", "rpee_cm_mean ppee_cm_mean"),
    ("RMS/bound", ".3f", "crlb_ratio_mean"),
    ("NEES", ".2f", "robot_nees_mean"),
    ("kurtosis", ".2f", "kurtosis_mean"),
    ("SNR dB", ".1f", "snr_db_mean"),
)


def _task_study(about: str, count: int) -> Study:
    return Study(
        about=about,
        trials=10,
        settings=TaskSettings,
        tasks=_task_parts(count),
        run_task=_run_start,
        rows=_task_rows,
        columns=_TASK_COLUMNS,
        figures=_figures(count),
    )


THREE = _task_study("PARTS's figures 4.2 to 4.4: three parts, three layouts of goals, noise, and filters", 3)
SIX = _task_study("PARTS's figures 4.9 to 4.11 and Table 4.2: the same with six parts", 6)
