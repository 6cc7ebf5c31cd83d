"""Layouts beyond those of PARTS: random goals, parts in each other's goals, and rings that have to be opened."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import msgspec
import numpy as np
from dynpf_experiments.extras import plotting
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study

from dynpf.rng import Draws, generator
from dynpf.types import Count, FloatArray
from dynpf_systems.parts.studies.runs import RADII, Conditions, measured, run_parts
from dynpf_systems.parts.task import NOISE, NoiseLevel, PartSpec, RearrangementTask

__all__ = ["CASES", "STUDY", "case_task"]

Case = Literal["random-3", "random-6", "swap", "cycle", "ringed", "walled-in"]

GAP = 0.04  # metres between goals, and from them to the walls
MOST_NPL = 2.0


class LayoutsSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The cases, the noise levels, and the number of particles."""

    cases: tuple[Case, ...] = get_args(Case)
    noises: tuple[NoiseLevel, ...] = ("none", "high")
    n: Count = 100


class Task(NamedTuple):
    """A run of a case with a noise level."""

    case: Case
    noise: NoiseLevel
    n: int
    seed: int


def case_task(case: Case, seed: int) -> RearrangementTask:
    """Return a random layout of a case, drawn from the seed."""
    return CASES[case](generator(seed, "layouts", 0, case))


def _random(random: Draws, count: int) -> RearrangementTask:
    """Return random goals, with gaps of at least ``GAP``; the simulator draws the starts."""
    radii = np.array(RADII[count])
    while True:
        goals = random.uniform(-1.0, 1.0, (count, 2)) * (1.0 - radii[:, None] - GAP)
        first, second = np.triu_indices(count, 1)
        if np.all(np.hypot(*(goals[first] - goals[second]).T) >= radii[first] + radii[second] + GAP):
            return _task(radii, goals)


def _swap(random: Draws) -> RearrangementTask:
    """Return two parts in each other's goals, 4 to 34 cm apart."""
    radii = random.permutation(RADII[6])[:2]
    apart = radii.sum() + random.uniform(GAP, 0.34)
    goals = _around(random.uniform(-0.4, 0.4, 2), 0.5 * apart, 2, random)
    return _task(radii, goals, goals[::-1])


def _cycle(random: Draws) -> RearrangementTask:
    """Return three parts, each in the goal of the next."""
    radii = random.permutation(RADII[6])[:3]
    goals = _around(random.uniform(-0.3, 0.3, 2), random.uniform(0.17, 0.3), 3, random)
    return _task(radii, goals, np.roll(goals, 1, axis=0))


def _ring(random: Draws, *, inside: bool) -> RearrangementTask:
    """Return five parts at home, in a ring that the robot cannot pass, and a part to be moved into or out of it."""
    radii = np.array([RADII[6][0], *random.permutation(RADII[6][1:])])
    centre, radius = random.uniform(-0.4, 0.4, 2), random.uniform(0.24, 0.28)
    ring = _around(centre, radius, 5, random)
    outside = centre
    while math.dist(outside, centre) < radius + 0.27:
        outside = random.uniform(-0.85, 0.85, 2)
    start, goal = (centre, outside) if inside else (outside, centre)
    return _task(radii, np.vstack([goal, ring]), np.vstack([start, ring]))


CASES: dict[Case, Callable[[Draws], RearrangementTask]] = {
    "random-3": lambda random: _random(random, 3),
    "random-6": lambda random: _random(random, 6),
    "swap": _swap,
    "cycle": _cycle,
    "ringed": lambda random: _ring(random, inside=False),
    "walled-in": lambda random: _ring(random, inside=True),
}


def _around(centre: FloatArray, radius: float, count: int, random: Draws) -> FloatArray:
    """Return points (count, 2), evenly spaced on a circle."""
    angles = random.uniform(0.0, math.tau) + np.linspace(0.0, math.tau, count, endpoint=False)
    points: FloatArray = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return points


def _task(radii: FloatArray, goals: FloatArray, starts: FloatArray | None = None) -> RearrangementTask:
    at = [None] * len(radii) if starts is None else [(x, y) for x, y in starts.tolist()]
    specs = zip(radii.tolist(), goals.tolist(), at, strict=True)
    return RearrangementTask(parts=tuple(PartSpec(radius=r, goal=(x, y), start=start) for r, (x, y), start in specs))


def _tasks(settings: LayoutsSettings, trials: int, seed: int) -> list[Task]:
    seeds = [int(generator(seed, "trial", number).integers(2**62)) for number in range(trials)]
    return [
        Task(case, noise, settings.n, run_seed)
        for case in settings.cases
        for noise in settings.noises
        for run_seed in seeds
    ]


def _run_task(task: Task) -> list[Sample]:
    conditions = _conditions(task)
    course = run_parts(case_task(task.case, task.seed), task.seed, conditions)
    found = measured(course, conditions)
    measures: dict[str, float | bool] = {
        "completed_25mm_percent": found["completed"],
        "collided_percent": found["collisions"] > 0,
        "npl": found["npl"],
        "npl_above_2_percent": found["npl"] > MOST_NPL,
        "nrl": found["nrl"],
        "pi": found["pi"],
        "final_error_mean_cm": 100.0 * found["final_error_mean_m"],
        "final_error_max_cm": 100.0 * found["final_error_max_m"],
        "ticks": float(len(course.robot)),
    }
    return [Sample({"case": task.case, "noise": task.noise, "n": conditions.particles}, measures)]


def _conditions(task: Task) -> Conditions:
    return Conditions(NOISE[task.noise].measurement, 0 if task.noise == "none" else task.n)


def _figures(settings: LayoutsSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:  # noqa: ARG001
    """Draw a noise-free run of the first layout of each case: starts, paths and goals of the parts."""
    pyplot = plotting()

    columns = min(len(settings.cases), 3)
    lines = math.ceil(len(settings.cases) / columns)
    figure, axes = pyplot.subplots(
        lines, columns, figsize=(3.6 * columns, 3.8 * lines), squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(settings.cases) :]:
        axis.remove()
    for axis, task in zip(
        axes.flat, _tasks(msgspec.structs.replace(settings, noises=("none",)), 1, seed), strict=False
    ):
        _draw(axis, task)
    figure.suptitle(
        "Noise-free runs: starts dashed, goals filled; paths of the parts, and of the robot in grey", fontsize=11
    )
    path = folder / "parts-layouts.png"
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
    return [path]


def _draw(axis: Any, task: Task) -> None:
    given = case_task(task.case, task.seed)
    course = run_parts(given, task.seed, _conditions(task))
    axis.plot(*course.robot.T, color="0.6", linewidth=0.7)
    parts = np.moveaxis(course.parts, 1, 0)
    for index, (spec, way) in enumerate(zip(given.parts, parts, strict=True)):
        colour = f"C{index}"
        axis.add_patch(_disc(spec.goal, spec.radius, facecolor=colour, alpha=0.35, linewidth=0))
        axis.add_patch(_disc(way[0], spec.radius, facecolor="none", edgecolor=colour, linestyle="--"))
        axis.plot(*way.T, color=colour, linewidth=1.4)
    axis.set(
        title=f"{task.case}: npl {measured(course, _conditions(task))['npl']:.2f}",
        aspect="equal",
        xlim=(-1, 1),
        ylim=(-1, 1),
    )
    axis.set(xlabel="x in m", ylabel="y in m")


def _disc(centre: Any, radius: float, **style: Any) -> Any:
    from matplotlib.patches import Circle  # noqa: PLC0415

    return Circle((float(centre[0]), float(centre[1])), radius, **style)


STUDY = Study(
    about="Layouts beyond those of PARTS: random goals, swaps, cycles, rings; with and without noise",
    trials=20,
    settings=LayoutsSettings,
    tasks=_tasks,
    run_task=_run_task,
    rows=lambda samples: summarized(samples, "case"),
    columns=(
        ("case", "", "case"),
        ("noise", "", "noise"),
        ("n", "", "n"),
        ("trials", "", "trials"),
        ("completed %", ".0f", "completed_25mm_percent"),
        ("collided %", ".0f", "collided_percent"),
        ("npl", ".3f", "npl_mean"),
        ("95 %", ".2f", "npl_p95"),
        ("above 2 %", ".0f", "npl_above_2_percent"),
        ("nrl", ".2f", "nrl_mean"),
        ("error cm: mean / max", ".2f", "final_error_mean_cm_mean final_error_max_cm_mean"),
    ),
    figures=_figures,
)
