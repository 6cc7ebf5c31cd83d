"""Global localization and recovery from kidnapping on real logs, by laser scans in a map.

The scenario ``laser-log`` is run on stretches of logs, each trial from another start. To kidnap the robot, its records
are withheld, odometry included, until the reference is farther than ``kidnapped_m`` from where it was.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_services.scenario.schema import Scenario
from msgspec import Meta

from dynpf.metrics.consistency import nees
from dynpf.rng import generator
from dynpf.se2 import wrap_angle
from dynpf.types import Count, Positive
from dynpf_systems.rooms.measures import FOUND_M, FOUND_RAD
from dynpf_systems.rooms.studies.kidnap_figures import Story, draw
from dynpf_systems.rooms.studies.laser_logs import LaserLog, log_named
from dynpf_systems.rooms.studies.laser_runs import Moment, kidnapped, play, scenario_for

__all__ = ["STUDY", "KidnapSettings", "Task", "run_task", "story_of", "tasks"]

HOLD = 5  # scans for which the estimate must stay near the truth to count as found
REST = 20  # scans in a stretch at least, where the log is long enough

ALARMS = frozenset({"lost", "kidnapped", "map_does_not_fit"})
"""Verdicts that are false alarms while the robot is tracked."""

STARTS: Mapping[str, str] = {
    "search": 'estimator.start={kind="search",spacing=0.4,kept=5000}',
    "uniform": 'estimator.start={kind="uniform"}',
}
KLD = '{kind="kld",cell_x=0.2,cell_y=0.2}'
FILTERS: Mapping[str, tuple[str, ...]] = {
    "relocation": (),
    "jump": (f'estimator.adaptation=[{KLD},{{kind="jump",log_likelihood_lost=-0.3}}]',),
    "augmented": (f'estimator.adaptation=[{KLD},{{kind="augmented"}}]', 'estimator.restart={kind="uniform"}'),
    "sir": (f"estimator.adaptation=[{KLD}]",),
}
"""Settings of the scenario for each filter: "jump" goes by one scan, "augmented" recovers as AMCL does, "sir" never."""

Case = Literal["tracking", "global", "kidnapped"]


class KidnapSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The logs, the filters, and the length of a trial."""

    # Names of logs in the project's data, or paths of recordings that dynpf import has made.
    logs: Annotated[tuple[str, ...], Meta(min_length=1)] = (
        "intel",
        "intel-split",
        "freiburg-split",
        "jarvis",
        "simpath2",
    )
    cases: Annotated[tuple[Case, ...], Meta(min_length=1)] = ("tracking", "global", "kidnapped")
    n: Annotated[tuple[Count, ...], Meta(min_length=1)] = (5000,)  # particles at the start, and at most
    filters: Annotated[tuple[Literal["relocation", "jump", "augmented", "sir"], ...], Meta(min_length=1)] = (
        "relocation",
    )
    starts: Annotated[tuple[Literal["search", "uniform"], ...], Meta(min_length=1)] = ("search",)
    updates: Count = 100  # updates within which the robot must be found
    delay: Count = 15  # updates within which the verdict must detect a kidnapping
    kidnapped_m: Positive = 5.0
    lead: Count = 30  # scans before a kidnapping
    tracking_trials: Count = 3  # at most, of the whole log from its known start


class Task(NamedTuple):
    """One trial."""

    log: str
    case: Case
    n: int
    filter: str
    start: str
    settings: KidnapSettings
    seed: int


def tasks(settings: KidnapSettings, trials: int, seed: int) -> list[Task]:
    """Return the trials; raises UsageError for a log that is absent."""
    for name in settings.logs:
        log_named(name)
    return [
        Task(log, case, n, chosen, start, settings, seed + trial)
        for log in settings.logs
        for case in settings.cases
        for n in settings.n
        for chosen in settings.filters
        for start in (settings.starts if case == "global" else ("known",))
        for trial in range(min(trials, settings.tracking_trials) if case == "tracking" else trials)
    ]


def run_task(task: Task) -> list[Sample]:
    """Return the measures of a trial; none where the log is too short for it."""
    name = log_named(task.log).name
    factors = {"dataset": name, "case": task.case, "filter": task.filter, "n": task.n, "start": task.start}
    story = story_of(task)
    if story is None:
        return []
    if task.case == "tracking":
        return [Sample(factors, _tracked(story.after))]
    found = _found(story.after, task.settings.updates, story.before[-1].updates if story.before else -1)
    if task.case == "global":
        return [Sample(factors, {"success_percent": not math.isnan(found), "updates_to_converge": found})]
    detected = _detected(story.after, story.before[-1].updates)
    measures = {
        "recovered_percent": not math.isnan(found),
        "updates_to_recover": found,
        "detected_percent": detected <= task.settings.delay,
        "detection_updates": detected,
        "false_alarm_percent": any(moment.status in ALARMS for moment in story.before),
    }
    return [Sample(factors, measures)]


def story_of(task: Task) -> Story | None:
    """Return the course of a trial; None where the log is too short for it."""
    log, scans = log_named(task.log), log_named(task.log).scans
    if task.case == "tracking":
        return Story(log, (), play(_scenario(log, task, _known(log, scans[0])), log.records[scans[0] :]))
    draws = generator(task.seed, "kidnap", 0, task.case)
    if task.case == "global":
        begin = scans[int(draws.integers(max(len(scans) - REST, 1)))]
        scenario = _scenario(log, task, STARTS[task.start])
        most = task.settings.updates
        return Story(log, (), play(scenario, log.records[begin:], enough=lambda _, updates: updates >= most))
    able = _able(log, task.settings.kidnapped_m)
    if not able:
        return None
    index = able[int(draws.integers(len(able)))]
    at, begin = scans[index], scans[max(index - task.settings.lead, 0)]
    return _carried_off(log, task, begin, at)


def _carried_off(log: LaserLog, task: Task, begin: int, at: int) -> Story:
    """Return the course of a trial with a known start at record ``begin`` and a kidnapping at record ``at``."""
    lead = sum(record.truth is not None for record in log.records[begin:at])
    updates_before = math.inf

    def enough(scans: int, updates: int) -> bool:
        """Return whether the updates after the kidnapping suffice."""
        nonlocal updates_before
        if scans == lead:
            updates_before = updates
        return updates >= updates_before + task.settings.updates

    records = kidnapped(log.records, at, task.settings.kidnapped_m)[begin:]
    moments = play(_scenario(log, task, _known(log, begin)), records, enough=enough)
    return Story(log, moments[:lead], moments[lead:])


def _scenario(log: LaserLog, task: Task, start: str) -> Scenario:
    least = min(task.n, 1000)
    sizes = (f"estimator.n={task.n}", f"estimator.adaptation.0.n_min={least}", f"estimator.adaptation.0.n_max={task.n}")
    return scenario_for(log, "laser-log", task.seed, (*FILTERS[task.filter], *sizes, start))


def _known(log: LaserLog, at: int) -> str:
    pose = log.records[at].truth
    assert pose is not None
    x, y, theta = pose
    return f'estimator.start={{kind="known",x={x!r},y={y!r},theta={theta!r},sigma_position=0.2,sigma_heading=0.1}}'


def _able(log: LaserLog, distance: float) -> list[int]:
    """Return the scans, except the first, after which the robot gets farther than ``distance`` with REST scans left."""
    positions = np.array([log.records[index].truth for index in log.scans])[:, :2]
    last = len(positions) - REST
    return [
        index for index in range(1, last) if np.hypot(*(positions[index:last] - positions[index]).T).max() > distance
    ]


def _tracked(moments: Sequence[Moment]) -> dict[str, float | bool]:
    position, heading = np.array([moment.errors for moment in moments]).T
    away = np.array([moment.estimate - moment.true for moment in moments if moment.estimate is not None]).T
    away[2] = wrap_angle(away[2])
    covariances = np.array([moment.covariance for moment in moments if moment.estimate is not None])
    return {
        "position_rmse_m": float(np.sqrt(np.mean(position**2))),
        "heading_rmse_rad": float(np.sqrt(np.mean(heading**2))),
        "nees": float(np.nanmean(nees(away, covariances))),
        "false_alarm_percent": any(moment.status in ALARMS for moment in moments),
    }


def _found(moments: Sequence[Moment], most: int, before: int) -> float:
    """Return the number of updates until the estimate is near the truth for HOLD scans; NaN above ``most``.

    It is also NaN where the estimate is not near at the end. ``before`` is the number of updates made before; -1 counts
    a start from readings, which the filter does not count, as an update.
    """
    near = np.array([moment.errors[0] <= FOUND_M and moment.errors[1] <= FOUND_RAD for moment in moments])
    for index, moment in enumerate(moments):
        if near[index : index + HOLD].all() and moment.updates - before <= most:
            return float(moment.updates - before) if near[-1] else math.nan
    return math.nan


def _detected(moments: Sequence[Moment], before: int) -> float:
    """Return the number of updates until a verdict detects the kidnapping, or NaN."""
    return next((float(moment.updates - before) for moment in moments if moment.status in ALARMS), math.nan)


def _rows(samples: list[Sample]) -> list[Row]:
    return [row for row in summarized(samples, "dataset") if row["dataset"] != "all"]


def _figures(settings: KidnapSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:  # noqa: ARG001
    stories: dict[tuple[str, str], Story] = {}
    for log in settings.logs:
        for case in settings.cases:
            start = settings.starts[0] if case == "global" else "known"
            story = story_of(Task(log, case, settings.n[0], settings.filters[0], start, settings, seed))
            if story is not None:
                stories[story.log.name, case] = story
    return draw(stories, folder)


STUDY = Study(
    about="Global localization and recovery from kidnapping on logs of real robots, by laser scans",
    trials=20,
    settings=KidnapSettings,
    tasks=tasks,
    run_task=run_task,
    rows=_rows,
    columns=(
        ("dataset", "", "dataset"),
        ("case", "", "case"),
        ("filter", "", "filter"),
        ("start", "", "start"),
        ("n", "", "n"),
        ("trials", "", "trials"),
        ("found %", ".0f", "success_percent"),
        ("updates / 95 %", ".1f", "updates_to_converge_median updates_to_converge_p95"),
        ("recovered %", ".0f", "recovered_percent"),
        ("updates / 95 %", ".1f", "updates_to_recover_median updates_to_recover_p95"),
        ("detected %", ".0f", "detected_percent"),
        ("updates / 95 %", ".1f", "detection_updates_median detection_updates_p95"),
        ("false alarm %", ".0f", "false_alarm_percent"),
        ("m", ".4f", "position_rmse_m_mean"),
        ("rad", ".4f", "heading_rmse_rad_mean"),
        ("NEES", ".1f", "nees_mean"),
    ),
    figures=_figures,
)
