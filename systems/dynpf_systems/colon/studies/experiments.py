"""COLON's experiments: numbers of particles, cases, growth of the area, and estimation of the map."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_protocol.errors import UsageError
from msgspec import Meta

from dynpf.colon import CASES, ROUTE, UNLISTED, Run
from dynpf.colon.outline import Family
from dynpf.colon.world import Route
from dynpf.metrics.colon import capsule_errors, first_visible, map_errors
from dynpf.metrics.quantiles import chi_square_quantile
from dynpf.motion.capsule import CapsuleMotion
from dynpf.se2 import wrap_angle
from dynpf.types import Count
from dynpf_systems.colon.measures import radius_error
from dynpf_systems.colon.studies.figures import draw
from dynpf_systems.colon.studies.worlds import (
    RADII,
    Change,
    Filter,
    MapFilter,
    Noise,
    Track,
    Trial,
    Tube,
    caster,
    follow,
    run,
)

__all__ = ["CASES_STUDY", "GROWTH", "HYPOTHESES", "PARTICLES", "CasesSettings", "change_of", "tubes"]

PRINTED_CASES = {
    1: (1.0732, 1.5973, 6.2108),
    2: (4.6165, 11.8877, 64.244),
    3: (1.208, 1.89962, 7.7777),
    4: (29.7674, 8.2426, 66.787),
    5: (11.5448, 7.1043, 30.1985),
}
"""COLON, Table 6.1: mean error of x, y and theta in %."""
PRINTED_PARTICLES = {
    20: (5.144, 3.581, 16.817),
    100: (1.208, 1.900, 7.778),
    500: (0.803, 1.551, 4.901),
    1000: (0.611, 1.195, 3.645),
    5000: (0.845, 1.365, 3.997),
}
"""COLON, Table 5.1."""
PRINTED_GROWTH = {"M_1": (0.169, 1.0182, 4.1656), "M_2": (1.2715, 1.3064, 6.2652), "M_3": (2.647, 3.5147, 5.8579)}
"""COLON, Table 5.3."""

_PROBABILITIES = (
    (0.99, "99 to 100 %"),
    (0.95, "95 to 99 %"),
    (0.85, "85 to 95 %"),
    (0.7, "70 to 85 %"),
    (0.0, "up to 70 %"),
)
"""Intervals of the probability of the likeliest map, from the highest down."""


class _Common(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    families: tuple[Family, ...] = tuple(Family)
    tubes: Count = 10  # of each family, used in turn
    maps: tuple[str, ...] = ()  # bitmaps of a, b and optionally c, instead of the families
    # A route of the user's own through bitmaps: the first pose and the motions (px, rad), and those before the change.
    start: tuple[float, float, float] = ROUTE.start
    route: tuple[tuple[float, float], ...] = ()
    change: int | None = None

    def __post_init__(self) -> None:
        if self.maps and len(self.maps) not in {2, 3}:
            raise ValueError(f"maps of {len(self.maps)} files; expected two, a and b, or three with c")
        if not self.maps and self.route_through() != ROUTE:
            raise ValueError("start, route and change go with maps: the families' tubes are made around COLON's route")
        if not 0 <= self.route_through().change < len(self.route_through().motions):
            raise ValueError(f"change = {self.change}: expected fewer motions than the route has, and not below 0")

    def route_through(self) -> Route:
        """Return the route of the trials."""
        motions = tuple(CapsuleMotion(*motion) for motion in self.route) or ROUTE.motions
        half = len(motions) // 2 if self.route else ROUTE.change
        return Route(self.start, motions, half if self.change is None else self.change)


class CasesSettings(_Common, frozen=True, kw_only=True):
    """Settings of the study of COLON's cases."""

    n: Count = 100
    cases: tuple[int, ...] = tuple(CASES)
    filters: tuple[MapFilter, ...] = ("seed", "scheduled", "told", "hypotheses")


class ParticlesSettings(_Common, frozen=True, kw_only=True):
    """Settings of the study of the number of particles."""

    n: tuple[Count, ...] = (20, 100, 500, 1000, 5000)
    n_ours: Count = 1000  # the most particles of our filter


class GrowthSettings(_Common, frozen=True, kw_only=True):
    """Settings of the study of a growing end."""

    n: Count = 100
    unlisted: tuple[float, ...] = (112.0, 127.5, 143.0)  # radii in px


class HypothesesSettings(_Common, frozen=True, kw_only=True):
    """Settings of the study of estimated maps."""

    n: Count = 100
    noises: tuple[Noise, ...] = ("none", "3px_5pct", "10px", "robot", "robot_3px_5pct")
    global_trials: Annotated[int, Meta(ge=0)] = 20  # of each family, at most


class Task(NamedTuple):
    """Trials with the same factors and tube, each with its own seed, for which "?" stands in a map's name."""

    case: str
    trial: Trial
    numbers: tuple[int, ...]


def change_of(case: int) -> Change:
    """Return the change of maps in one of COLON's cases."""
    return Change("a", (CASES[case].true,), CASES[case].told)


def tubes(settings: _Common, trials: int, seed: int) -> Iterator[tuple[Tube, tuple[int, ...]]]:
    """Yield each tube and the numbers of its trials; tubes of a family take turns."""
    if settings.maps:
        yield Tube(None, 0, settings.maps, settings.route_through()), tuple(range(trials))
        return
    for family in settings.families:
        for number in range(min(settings.tubes, trials)):
            yield Tube(family, seed + number), tuple(range(number, trials, settings.tubes))


def _cases(settings: _Common) -> tuple[int, ...]:
    return tuple(case for case in CASES if CASES[case].true != "c" or len(settings.maps) != 2)


# Measures of a trial.


def _run_task(task: Task, calibration: bool = False) -> list[Sample]:
    samples = []
    for number in task.numbers:
        seed = task.trial.seed * 100_003 + number
        change = task.trial.change
        change = change._replace(true=tuple(name.replace("?", str(seed)) for name in change.true))
        trial = task.trial._replace(seed=seed, change=change)
        happened = run(trial)
        names = ("seed", "seed_program") if trial.filter == "seed" else (trial.filter,)
        for name, track in zip(names, follow(trial, happened), strict=True):
            factors = _factors(task, name)
            measures = _pose_measures(happened, track) | _map_measures(trial, happened, track)
            if task.case == "random" and not _is_told_apart(trial, happened):
                factors["case"] = "random, unseen"
            if track.radius is not None:
                measures["error_radius_percent"] = radius_error(track.radius, happened.maps[-1])
            samples.append(Sample(factors, measures))
            if calibration:
                samples += _calibration(task, name, happened, track, measures)
    return samples


def _calibration(task: Task, name: str, happened: Run, track: Track, measures: dict[str, float | bool]) -> list[Sample]:
    """Return the samples of calibration, pooled over all cases.

    They are whether the pose is in its 90 % region at the end and, at every reading, whether the likeliest map is the
    true one, by the probability that the filter gives it.
    """
    pooled = _factors(task, name) | {"case": "all"}
    samples = [Sample(pooled, {"covered_90_percent": measures["covered_90_percent"]})]
    for true, maps in zip(happened.maps, track.maps, strict=True):
        likeliest = max(maps, key=maps.__getitem__)
        label = next(label for least, label in _PROBABILITIES if maps[likeliest] >= least)
        right = likeliest == (true if true in maps else UNLISTED)
        found = {"said_percent": 100.0 * maps[likeliest], "right_percent": right}
        samples.append(Sample(pooled | {"said": label}, found))
    return samples


def _factors(task: Task, name: str) -> dict[str, str | int]:
    trial = task.trial
    return {
        "case": task.case,
        "tube": trial.tube.name,
        "filter": name,
        "n": trial.n,
        "start": "known" if trial.known else "global",
        "noise": trial.noise,
    }


def _pose_measures(happened: Run, track: Track) -> dict[str, float | bool]:
    true, pose = happened.poses[:, -1], track.poses[:, -1]
    measures = capsule_errors(true, pose)
    measures["lost_percent"] = measures.pop("lost")
    if track.covariance is not None:
        off = np.array([pose[0] - true[0], pose[1] - true[1], float(wrap_angle(pose[2] - true[2]))])
        distance = float(off @ np.linalg.solve(track.covariance + 1e-9 * np.eye(3), off))
        measures["covered_90_percent"] = distance < chi_square_quantile(0.9, 3)
    return measures


def _map_measures(trial: Trial, happened: Run, track: Track) -> dict[str, float | bool]:
    if not track.maps:
        return {}
    visible = first_visible(happened.maps, happened.poses, lambda name: caster(trial.tube, name))
    measures = map_errors(happened.maps, track.maps, visible)
    for name in ("false_alarm", "missed"):
        measures[f"{name}_percent"] = measures.pop(name)
    if happened.maps[-1] != happened.maps[0]:
        measures["posterior_changed"] = 1.0 - track.maps[-1][happened.maps[0]]
    return measures


def _is_told_apart(trial: Trial, happened: Run) -> bool:
    """Return whether some range after the change differs from that of each listed map."""
    since = next(step for step, name in enumerate(happened.maps) if name != happened.maps[0])
    maps, poses = happened.maps[since:], happened.poses[:, since:]
    of = partial(caster, trial.tube)
    return all(first_visible((listed, *maps), poses[:, [0, *range(len(maps))]], of) is not None for listed in "ab")


# The studies.


def _beside(
    printed: dict[str, tuple[float, float, float]], factor: str, start: str
) -> Callable[[list[Sample]], list[Row]]:
    """Return a function that summarizes samples and adds COLON's figures by the value of a factor."""

    def rows(samples: list[Sample]) -> list[Row]:
        """Return the summarized rows with COLON's figures."""
        found = summarized(samples, "tube")
        for row in found:
            figures = printed.get(str(row[factor]))
            if figures is not None and row["start"] == start:
                names = ("x", "y", "theta")
                row |= {f"printed_error_{name}_percent": value for name, value in zip(names, figures, strict=True)}
        return found

    return rows


def _case_tasks(settings: CasesSettings, trials: int, seed: int) -> list[Task]:
    return [
        Task(str(case), Trial(tube, change_of(case), "none", name, settings.n, True, seed), numbers)
        for tube, numbers in tubes(settings, trials, seed)
        for case in settings.cases
        if case in _cases(settings)
        for name in settings.filters
    ]


def _particle_tasks(settings: ParticlesSettings, trials: int, seed: int) -> list[Task]:
    kinds: tuple[tuple[Filter, bool], ...] = (("seed", True), ("seed", False), ("told", True))
    return [
        Task("3", Trial(tube, change_of(3), "none", name, n, known, seed), numbers)
        for tube, numbers in tubes(settings, trials, seed)
        for n in settings.n
        for name, known in kinds
        if name == "seed" or n <= settings.n_ours
    ]


def _hypothesis_tasks(settings: HypothesesSettings, trials: int, seed: int) -> list[Task]:
    changes = {str(case): change_of(case) for case in _cases(settings)}
    if not settings.maps:
        changes["random"] = Change("a", ("other ?",), "a")
        changes["growing"] = Change("a", (*(f"b {step / 6:.3f}" for step in range(1, 6)), "b"), "a")
    tasks = []
    for tube, numbers in tubes(settings, trials, seed):
        searching = tuple(number for number in numbers if number < settings.global_trials)
        for case, change in changes.items():
            trial = Trial(tube, change, "none", "hypotheses", settings.n, True, seed)
            tasks += [Task(case, trial._replace(noise=noise), numbers) for noise in settings.noises]
            if searching and case not in {"3", "4"}:  # without a schedule they equal 2 and 1
                tasks.append(Task(case, trial._replace(known=False), searching))
    return tasks


def _growth_tasks(settings: GrowthSettings, trials: int, seed: int) -> list[Task]:
    if settings.maps:
        raise UsageError("--set maps: colon-growth needs generated tubes with round ends; leave maps out")
    before = f"end {RADII['M_1']:g}"
    kinds: tuple[Filter, ...] = ("seed", "end_radius")
    radii = RADII | {f"{radius:g} px": radius for radius in settings.unlisted}
    return [
        Task(
            case,
            Trial(tube, Change(before, (f"end {radius:g}",), before), "none", name, settings.n, True, seed),
            numbers,
        )
        for tube, numbers in tubes(settings, trials, seed)
        for case, radius in radii.items()
        for name in kinds
    ]


_FACTORS = (("case", "", "case"), ("tube", "", "tube"), ("filter", "", "filter"), ("n", "", "n"))
_RADIUS = (("radius %", ".2f", "error_radius_percent_mean"), ("95 %", ".2f", "error_radius_percent_p95"))
_ERRORS = (
    ("trials", "", "trials"),
    ("error % x / y / theta", ".3f", "error_x_percent_mean error_y_percent_mean error_theta_percent_mean"),
    ("median", ".3f", "error_x_percent_median error_y_percent_median error_theta_percent_median"),
    ("95 %", ".3f", "error_x_percent_p95 error_y_percent_p95 error_theta_percent_p95"),
    ("printed", ".3f", "printed_error_x_percent printed_error_y_percent printed_error_theta_percent"),
    ("px", ".2f", "error_position_px_mean"),
    ("rad", ".4f", "error_theta_rad_mean"),
    ("lost %", ".1f", "lost_percent"),
)
_MAPS = (
    ("p(truth)", ".3f", "posterior_truth_mean"),
    ("false %", ".1f", "false_alarm_percent"),
    ("missed %", ".1f", "missed_percent"),
    ("delay", ".2f", "delay_steps_mean"),
    ("in 90 %", ".0f", "covered_90_percent"),
)
_CALIBRATION = (
    ("probability of map", "", "said"),
    ("mean", ".1f", "said_percent_mean"),
    ("right %", ".1f", "right_percent"),
)
_START = ("start", "", "start")


def _hypothesis_rows(samples: list[Sample]) -> list[Row]:
    """Return the rows, with rows of calibration pooled over all kinds of noise."""
    pooled = [sample._replace(factors=sample.factors | {"noise": "all"}) for sample in samples if _is_pooled(sample)]
    return summarized([*samples, *pooled], "tube")


def _is_pooled(sample: Sample) -> bool:
    return bool(sample.factors["case"] == "all" and sample.factors["start"] == "known")


def _figures(settings: _Common, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    return draw(next(tubes(settings, 1, seed))[0], seed, rows, folder)


PARTICLES = Study(
    about="COLON's Table 5.1: error against the number of particles",
    trials=100,
    settings=ParticlesSettings,
    tasks=_particle_tasks,
    run_task=_run_task,
    rows=_beside({str(n): figures for n, figures in PRINTED_PARTICLES.items()}, "n", "known"),
    columns=(*_FACTORS, _START, *_ERRORS),
    figures=_figures,
)

CASES_STUDY = Study(
    about="COLON's Table 6.1: five cases of maps that change or not, and of schedules that follow or not",
    trials=100,
    settings=CasesSettings,
    tasks=_case_tasks,
    run_task=_run_task,
    rows=_beside({str(case): figures for case, figures in PRINTED_CASES.items()}, "case", "known"),
    columns=(*_FACTORS, *_ERRORS, *_MAPS),
    figures=_figures,
)

GROWTH = Study(
    about="COLON's Table 5.3: the end of the tube grows; its radius is estimated",
    trials=100,
    settings=GrowthSettings,
    tasks=_growth_tasks,
    run_task=_run_task,
    rows=_beside(PRINTED_GROWTH, "case", "known"),
    columns=(*_FACTORS, *_ERRORS, *_RADIUS),
    figures=_figures,
)

HYPOTHESES = Study(
    about="The map is estimated, without a schedule for the filter",
    trials=100,
    settings=HypothesesSettings,
    tasks=_hypothesis_tasks,
    run_task=partial(_run_task, calibration=True),
    rows=_hypothesis_rows,
    columns=(*_FACTORS, ("noise", "", "noise"), _START, *_ERRORS, *_MAPS, *_CALIBRATION),
    figures=_figures,
)
