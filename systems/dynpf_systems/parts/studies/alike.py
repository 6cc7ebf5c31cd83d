"""Parts that look alike: ten layouts with equal radii, with and without a camera, by what is known of who is who.

Nothing but positions and motion tells these discs apart: all have one grey, and in every second layout the robot is as
large as the parts. Either the parts are interchangeable, or where each starts is given, or nothing is known: then two
parts can be told apart by nobody, and the right end of a run is to say so.
"""

import itertools
import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
from dynpf_experiments.drive import drive
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from msgspec import Meta

from dynpf.metrics.seeds import proportion
from dynpf.rng import Draws, generator
from dynpf.types import Count
from dynpf_systems.parts.measures import TOPICS, course_of, rearrangement
from dynpf_systems.parts.simulator import draw_starts
from dynpf_systems.parts.studies.solvable import order_of
from dynpf_systems.parts.task import NoiseLevel, PartSpec, RearrangementTask, layout_of

__all__ = ["COUNTS", "CROWD", "STUDY", "AlikeSettings", "alike_scenario", "alike_task", "crowd_task", "solvable_seeds"]

Known = Literal["interchangeable", "starts", "nothing"]

COUNTS = (2, 3, 4, 5, 6, 7, 8, 9, 10, 10)
"""Parts of the layouts."""
DRAWS = (0, 0, 0, 0, 0, 0, 0, 0, 1, 0)
"""Which draw of each layout is taken: the first that is solvable from one of three draws of starts."""
CROWD = 20
"""Parts of the crowded layouts."""
GREY = 60.0  # of all discs
LAYOUT_SEED = 2006
GAP = 0.04  # m, between goals and from them to the walls
SPARE = 0.06  # m, that the robot has between any two discs at the start


class AlikeSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which layouts, noise levels and cameras, and what is known of the parts."""

    layouts: tuple[Annotated[int, Meta(ge=0, lt=len(COUNTS))], ...] = tuple(range(len(COUNTS)))
    noises: tuple[NoiseLevel, ...] = ("low", "high")
    cameras: tuple[bool, ...] = (False, True)
    known: tuple[Known, ...] = get_args(Known)
    crowds: Annotated[int, Meta(ge=0)] = 0  # also this many layouts of 20 parts, of random radii, without a camera
    n: Count = 100
    ticks: Count = 12000  # after which a run is given up


class _Run(NamedTuple):
    layout: int
    crowd: bool
    noise: NoiseLevel
    camera: bool
    known: Known
    n: int
    ticks: int
    seed: int


def alike_task(number: int, draw: int | None = None) -> RearrangementTask:
    """Return layout ``number``: parts of one radius, in every second layout that of the robot."""
    random = generator(LAYOUT_SEED, f"alike {number}", DRAWS[number] if draw is None else draw)
    count = COUNTS[number]
    radius = round(float(random.uniform(0.04, min(0.10, 0.22 / math.sqrt(count)))), 3)
    robot = radius if number % 2 else round(float(random.uniform(0.05, 0.10)), 3)
    return _with_goals(random, [radius] * count, robot, 2.0)


def crowd_task(number: int) -> RearrangementTask:
    """Return a layout of 20 parts with random radii, some of them alike, in 3 m x 3 m."""
    random = generator(LAYOUT_SEED, "crowd", number)
    radii = [round(radius, 3) for radius in random.uniform(0.04, 0.08, CROWD).tolist()]
    return _with_goals(random, radii, round(float(random.uniform(0.05, 0.08)), 3), 3.0)


def _with_goals(random: Draws, radii: list[float], robot: float, side: float) -> RearrangementTask:
    goals: list[tuple[float, float]] = []
    while len(goals) < len(radii):
        radius = radii[len(goals)]
        x, y = ((side / 2.0 - radius - GAP) * random.uniform(-1.0, 1.0, 2)).tolist()
        apart = [math.dist((x, y), goal) - radius - other for goal, other in zip(goals, radii, strict=False)]
        if min(apart, default=GAP) >= GAP:
            goals.append((round(x, 3), round(y, 3)))
    parts = tuple(PartSpec(radius=radius, goal=goal) for radius, goal in zip(radii, goals, strict=True))
    return RearrangementTask(parts=parts, robot_radius=robot, width=side, height=side)


def alike_scenario(task: RearrangementTask, seed: int, noise: NoiseLevel, known: Known, *, camera: bool) -> Scenario:
    """Return the scenario of a run; what is known of the parts goes into its task."""
    base = _base(camera)
    simulator = msgspec.structs.replace(base.simulator, start_gap=2.0 * task.robot_radius + SPARE)
    if camera:
        painted = msgspec.structs.replace(simulator.camera, robot_colour=simulator.camera.part_colour)
        simulator = msgspec.structs.replace(simulator, camera=painted)
    task = msgspec.structs.replace(task, noise=noise)
    if known == "interchangeable":
        radii = [part.radius for part in task.parts]
        groups = [tuple(i for i, other in enumerate(radii) if other == radius) for radius in dict.fromkeys(radii)]
        task = msgspec.structs.replace(task, interchangeable=tuple(group for group in groups if len(group) > 1))
    if known == "starts":
        _, starts = draw_starts(task, simulator, generator(seed, "simulator", 0, "start"))
        placed = zip(task.parts, starts.tolist(), strict=True)
        parts = tuple(msgspec.structs.replace(part, start=(x, y)) for part, (x, y) in placed)
        task = msgspec.structs.replace(task, parts=parts)
    return base.changed(seed=seed, task=task, simulator=simulator)


@lru_cache(maxsize=2)
def _base(camera: bool) -> Scenario:
    if camera:
        return load_scenario("parts-3-easy")
    grey = [f"sensors.overhead.{disc}_grey={GREY}" for disc in ("robot", "part")]
    return load_scenario("parts-3-tracked", overrides=grey)


def solvable_seeds(task: RearrangementTask, seed: int, draws: int | None = None) -> Iterator[int]:
    """Return seeds of runs whose drawn starts can be brought home (``order_of``), of at most so many ``draws``."""
    layout = layout_of(task)
    config = msgspec.structs.replace(_base(False).simulator, start_gap=2.0 * task.robot_radius + SPARE)
    for trial in itertools.count() if draws is None else range(draws):
        run_seed = int(generator(seed, "trial", trial).integers(2**62))
        robot, starts = draw_starts(task, config, generator(run_seed, "simulator", 0, "start"))
        if order_of(layout, robot, starts) is not None:
            yield run_seed


def _tasks(settings: AlikeSettings, trials: int, seed: int) -> list[_Run]:
    runs = []
    for layout in settings.layouts:
        for run_seed in itertools.islice(solvable_seeds(alike_task(layout), seed), trials):
            runs += [
                _Run(layout, False, noise, camera, known, settings.n, settings.ticks, run_seed)
                for noise in settings.noises
                for camera in settings.cameras
                for known in settings.known
            ]
    crowds = ((layout, next(solvable_seeds(crowd_task(layout), seed, 3), None)) for layout in itertools.count())
    found = ((layout, run_seed) for layout, run_seed in crowds if run_seed is not None)
    for layout, run_seed in itertools.islice(found, settings.crowds):
        runs += [
            _Run(layout, True, noise, False, "interchangeable", settings.n, settings.ticks, run_seed)
            for noise in settings.noises
        ]
    return runs


def _run_task(run: _Run) -> list[Sample]:
    task = crowd_task(run.layout) if run.crowd else alike_task(run.layout)
    scenario = alike_scenario(task, run.seed, run.noise, run.known, camera=run.camera)
    estimator = msgspec.structs.replace(scenario.estimator, n=run.n)
    course = course_of(drive(scenario.changed(estimator=estimator, max_ticks=run.ticks), TOPICS))
    assert course is not None
    found = rearrangement(course)
    measures: dict[str, float | bool] = {
        "completed_25mm_percent": found["completed"],
        "collided_percent": found["collisions"] > 0,
        "swapped_percent": found.get("swaps_unnoticed", 0) > 0 or (found["finished"] and not found["completed"]),
        "told_percent": not found["finished"],
        "seconds": course.tick_s * len(course.robot),
        "npl": found["npl"],
    }
    parts = str(CROWD) if run.crowd else "2-10 alike"
    factors = {"parts": parts, "camera": run.camera, "noise": run.noise, "known": run.known}
    return [Sample(factors | {"layout": run.layout}, measures)]


def _rows(samples: list[Sample]) -> list[Row]:
    rows = summarized(samples, "layout")
    for row in rows:
        swapped = round(row["swapped_percent"] * row["trials"] / 100.0)
        row["swapped_at_most_percent"] = 100.0 * proportion(swapped, row["trials"]).high
    return rows


def _figures(settings: AlikeSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:  # noqa: ARG001
    return []


STUDY = Study(
    about="Parts that look alike: ten layouts of equal discs, by what is known of who is who",
    trials=20,
    settings=AlikeSettings,
    tasks=_tasks,
    run_task=_run_task,
    rows=_rows,
    columns=(
        *((name, "", name) for name in ("parts", "camera", "noise", "known", "layout", "trials")),
        ("completed % (95 %)", ".1f", "completed_25mm_percent completed_25mm_percent_ci_low"),
        ("collided % (95 %)", ".1f", "collided_percent collided_percent_ci_high"),
        ("swapped unnoticed % (95 %)", ".1f", "swapped_percent swapped_percent_ci_high"),
        ("said not finished %", ".1f", "told_percent"),
        ("npl", ".2f", "npl_mean"),
        ("s", ".0f", "seconds_median"),
    ),
    figures=_figures,
)
