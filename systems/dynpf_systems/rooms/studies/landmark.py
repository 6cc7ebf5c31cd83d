"""LANDMARK's experiments on the logs of real robots among landmarks (UTIAS MRCLAM).

The scenario ``landmark-mrclam`` is run on stretches of a log whose starts are spread evenly over it, each with its own
seed. Positions are scored at 10 Hz, where the reference has no gap; headings where the reference's heading is valid.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import msgspec
import numpy as np
from dynpf_experiments.data import data_path
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from numpy.typing import NDArray

from dynpf.maps.landmarks import LandmarkMap
from dynpf.measurement.range_bearing import RangeBearing, RangeBearingParams, RangeBearingReadings
from dynpf.metrics.trajectory import pose_errors, score
from dynpf.types import Count, Positive
from dynpf_systems.rooms.measures import FOUND_M, FOUND_RAD
from dynpf_systems.rooms.studies.landmark_figures import draw
from dynpf_systems.rooms.studies.landmark_logs import (
    Change,
    LandmarkLog,
    Run,
    Stretch,
    datasets,
    every_second_landmark,
    follow,
    nearest_past,
    opened,
    stretches,
    withheld,
)
from dynpf_systems.rooms.studies.logs import sources

__all__ = ["STUDY", "LandmarkSettings", "Task", "run_task", "tasks"]

DEFAULT = "mrclam-9-3"
"""The default log; see ``logs.toml``."""

HOLD_S = 10.0  # the estimate must stay near the truth so long to count as found
DOCUMENT_N = 20  # particles with which LANDMARK varies the initial spread

PRINTED = {
    6: ((2.0, 3.0, 0.0), 8.573130, -1.584756),
    13: ((0.0, 3.0, 0.0), 4.129145, -1.196759),
    17: ((1.0, -2.0, 0.0), 5.216302, -3.075999),
}
"""LANDMARK, section 6: pose, and the range (m) and bearing (rad) expected of a landmark; the last two bearings are
those of another pose. Of its experiments it prints figures, but no numbers."""

_PRIOR = 'estimator.proposal={kind="prior"}'
FILTERS: Mapping[str, tuple[str, ...]] = {
    "extended_kalman": ('estimator.filter={kind="extended_kalman"}', _PRIOR),
    "unscented_kalman": ('estimator.filter={kind="unscented_kalman"}', _PRIOR),
    "sir": (_PRIOR,),
    "local_linearization": ('estimator.proposal={kind="local_linearization"}',),
    "auxiliary": ('estimator.proposal={kind="auxiliary"}',),
    "regularized": (_PRIOR, 'estimator.regularization={kind="gaussian_kernel",shrink=true}'),
    "kld": (_PRIOR, 'estimator.adaptation=[{kind="kld"}]'),
}
"""Settings of the scenario for each estimator."""

MODELS: Mapping[str, tuple[tuple[str, ...], Change | None]] = {
    "as in the scenario": ((), None),
    "no calibration": (("estimator.calibration={turn_scale_sigma=0.0,turn_scale_walk=0.0}",), None),
    "turn scale alone": (("estimator.calibration={turn_scale_sigma=0.15}",), None),
    "and range scale": (("estimator.calibration.range_scale_sigma=0.03",), None),
    "and odometry lag": (("estimator.calibration.lag_sigma=0.1",), None),
    "no gate": (("estimator.measurement.0.gate=1e9", "estimator.measurement.0.outlier_fraction=0.0"), None),
    "nearest past": ((), nearest_past),
    "every second landmark": ((), every_second_landmark),
}
"""Changes of the models or of the readings."""

Experiment = Literal["expectations", "particles", "filters", "models", "spread", "withheld", "unknown"]


class LandmarkSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The logs, the experiments, and their particle counts, filters, models and starts."""

    # Imported logs, or folders of MRCLAM data sets; without, data set 9, robot 3 from the folder of data.
    data: tuple[str, ...] = ()
    robot: int | None = None  # of a folder with several; without, each of them
    experiments: tuple[Experiment, ...] = get_args(Experiment)
    n: tuple[Count, ...] = (10, 100, 1000, 10000)
    filters: tuple[str, ...] = tuple(FILTERS)
    filters_n: Count = 1000
    models: tuple[str, ...] = tuple(MODELS)
    spreads: tuple[float, ...] = (0.05, 0.5, 2.0)  # m and rad, standard deviations of the start
    seconds: Positive = 450.0  # of the log, for each trial; of spreads and unknown starts the first part alone
    withheld: Count = 200
    unknown_trials: Count = 50

    def __post_init__(self) -> None:
        for name, chosen, known in (("filters", self.filters, FILTERS), ("models", self.models, MODELS)):
            if unknown := [name for name in chosen if name not in known]:
                raise ValueError(f"{name} has {unknown[0]!r}; expected some of {', '.join(known)}")


class Task(NamedTuple):
    """Trials of one kind on one log."""

    path: str
    robot: int | None
    experiment: str
    filter: str
    n: int
    start: str
    readings: str
    overrides: tuple[str, ...]
    seconds: float
    numbers: tuple[int, ...]
    trials: int  # in all, over which the starts are spread
    seed: int
    missing: int = 0  # readings withheld at first


def tasks(settings: LandmarkSettings, trials: int, seed: int) -> list[Task]:
    """Return the trials of all experiments, in tasks of at most five."""
    return [
        task._replace(numbers=tuple(range(first, min(first + 5, task.trials))))
        for path, robot in datasets(_paths(settings), settings.robot)
        for task in _kinds(settings, trials, seed, path, robot)
        for first in range(0, task.trials, 5)
    ]


def _paths(settings: LandmarkSettings) -> tuple[str, ...]:
    instead = "--set \"data=['IN.mcap']\" takes recordings that dynpf import mrclam has made, and folders of data sets"
    return settings.data or (str(data_path("landmark", sources().landmark[DEFAULT].folder, instead)),)


def _kinds(settings: LandmarkSettings, trials: int, seed: int, path: str, robot: int | None) -> Iterator[Task]:
    whole, short = settings.seconds, min(settings.seconds, 60.0)
    base = Task(path, robot, "", "sir", settings.filters_n, "known", "all", (), whole, (), trials, seed)
    wanted = settings.experiments
    if "expectations" in wanted:
        yield base._replace(experiment="expectations", trials=1)
    if "particles" in wanted:
        for n in settings.n:
            yield base._replace(experiment="particles", n=n)
    if "filters" in wanted:
        for name in settings.filters:
            yield base._replace(experiment="filters", filter=name, overrides=FILTERS[name])
    if "models" in wanted:
        for name in settings.models:
            yield base._replace(experiment="models", readings=name, overrides=MODELS[name][0])
    if "spread" in wanted:
        for spread in settings.spreads:
            start = tuple(f"estimator.start.sigma_{what}={spread}" for what in ("position", "heading"))
            yield base._replace(
                experiment="spread", n=DOCUMENT_N, start=f"known {spread:g}", overrides=start, seconds=short
            )
    if "withheld" in wanted:
        yield base._replace(
            experiment="withheld", readings=f"first {settings.withheld} withheld", missing=settings.withheld
        )
    if "unknown" in wanted:
        for n in (100, settings.filters_n):
            yield base._replace(
                experiment="unknown", n=n, start="unknown", seconds=short, trials=max(trials, settings.unknown_trials)
            )


def run_task(task: Task) -> list[Sample]:
    """Return the samples of a task's trials."""
    log = opened(task.path, task.robot)
    if task.experiment == "expectations":
        return list(_expectations(log))
    ways = stretches(log, task.trials, task.seconds)
    return [sample for number in task.numbers for sample in _trial(task, log, ways[number], task.seed + number)]


def _trial(task: Task, log: LandmarkLog, stretch: Stretch, seed: int) -> Iterator[Sample]:
    change = withheld(task.missing) if task.missing else MODELS.get(task.readings, ((), None))[1]
    run = follow(log, stretch, seed, _overrides(task, log), change)
    factors = _factors(task, log)
    yield Sample(factors, _measures(task, log, run))
    if task.experiment == "filters" and task.filter == "sir":  # once is enough: it is the same for all
        alone = score(run.reckoned, log.truth, heading_valid=log.heading_valid)
        measures: dict[str, float | bool] = {
            "position_rmse_m": alone.position_rmse_m,
            "heading_rmse_rad": alone.heading_rmse_rad,
        }
        yield Sample(factors | {"filter": "dead_reckoning", "n": 0}, measures)


def _overrides(task: Task, log: LandmarkLog) -> list[str]:
    chosen = [f"estimator.n={task.n}", *task.overrides]
    if task.start == "unknown":
        (west, south), (east, north) = (
            (bound([mark.x for mark in log.landmarks]), bound([mark.y for mark in log.landmarks]))
            for bound in (min, max)
        )
        box = f"{{x_min={west},x_max={east},y_min={south},y_max={north}}}"
        chosen.append(f'estimator.start={{kind="from_readings",base={{box={box}}}}}')
    return chosen


def _factors(task: Task, log: LandmarkLog) -> dict[str, str | int]:
    return {
        "experiment": task.experiment,
        "dataset": log.name,
        "filter": task.filter,
        "n": task.n,
        "start": task.start,
        "readings": task.readings,
    }


def _measures(task: Task, log: LandmarkLog, run: Run) -> dict[str, float | bool]:
    scored = score(run.estimate, log.truth, heading_valid=log.heading_valid)
    measures: dict[str, float | bool] = {
        "position_rmse_m": scored.position_rmse_m,
        "heading_rmse_rad": scored.heading_rmse_rad,
    }
    # Swapped markers turn the reference's heading and shift its position, too; so errors are also given without them.
    errors = pose_errors(run.estimate, log.truth, heading_valid=log.heading_valid)
    squares = np.sum(errors.errors[:2, errors.heading_valid] ** 2, axis=0)
    measures["position_rmse_sound_m"] = math.sqrt(squares.mean()) if squares.size else math.nan
    found = _found(log, run)
    if task.experiment in ("unknown", "spread", "withheld"):
        converged = np.flatnonzero(found)
        measures["success_percent"] = bool(converged.size)
        measures["readings_to_converge"] = float(run.readings[converged[0]]) if converged.size else math.nan
    if task.experiment == "withheld":
        measures["recovered_percent"] = bool(found.any())
        near = run.readings >= 1
        after = run.estimate._replace(stamps=run.estimate.stamps[near], poses=run.estimate.poses[:, near])
        late = score(after, log.truth, heading_valid=log.heading_valid)
        measures["position_rmse_after_m"] = late.position_rmse_m
    return measures


def _found(log: LandmarkLog, run: Run) -> NDArray[np.bool_]:
    """Return, for each estimate, whether it and all estimates of the next ten seconds are near the truth, (T,).

    Before the first reading nothing counts as found. Where the reference is invalid, an estimate counts as near.
    """
    errors = pose_errors(run.estimate, log.truth, heading_valid=log.heading_valid)
    far = errors.position_valid & (np.hypot(*errors.errors[:2]) > FOUND_M)
    far |= errors.heading_valid & (np.abs(errors.errors[2]) > FOUND_RAD)
    stamps = run.estimate.stamps
    last = np.searchsorted(stamps, stamps + HOLD_S, side="right")
    total = np.concatenate([[0], np.cumsum(far)])
    found: NDArray[np.bool_] = (total[last] == total[:-1]) & (run.readings > 0) & (stamps + HOLD_S <= stamps[-1])
    return found


def _expectations(log: LandmarkLog) -> Iterator[Sample]:
    """Yield the expectations of the measurement model for which LANDMARK prints values."""
    marks = LandmarkMap((mark.id, mark.x, mark.y) for mark in log.landmarks)
    model = RangeBearing(RangeBearingParams(), marks)
    for landmark, (pose, _, _) in PRINTED.items():
        if landmark not in marks:
            continue
        nothing = np.zeros(1)
        innovation = model.innovation(
            np.array(pose)[:, None], RangeBearingReadings(np.array([landmark]), nothing, nothing)
        )
        measures: dict[str, float | bool] = {
            "expected_range_m": float(-innovation[0, 0]),
            "expected_bearing_rad": float(-innovation[1, 0]),
        }
        factors = {"experiment": "expectations", "dataset": log.name, "filter": "", "n": 0, "start": str(pose)}
        yield Sample(factors | {"readings": f"landmark {landmark}"}, measures)


def _rows(samples: list[Sample]) -> list[Row]:
    rows = summarized(samples, "dataset")
    several = len({row["dataset"] for row in rows}) > 2  # with a single log "all" would repeat it
    for row in rows:
        if row["experiment"] == "expectations":
            _, distance, bearing = PRINTED[int(str(row["readings"]).removeprefix("landmark "))]
            row |= {"printed_range_m": distance, "printed_bearing_rad": bearing}
    return [row for row in rows if several or row["dataset"] != "all"]


def _figures(settings: LandmarkSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    path, robot = datasets(_paths(settings), settings.robot)[0]
    log = opened(path, robot)
    whole = stretches(log, 1, 0.0)[0]
    whole = whole._replace(last=(log.records[-1].stamp_ns - log.start_ns) * 1e-9)
    return draw(log, follow(log, whole, seed, []), rows, folder)


_COLUMNS = (
    ("experiment", "", "experiment"),
    ("dataset", "", "dataset"),
    ("filter", "", "filter"),
    ("n", "", "n"),
    ("start", "", "start"),
    ("readings", "", "readings"),
    ("trials", "", "trials"),
    ("position RMSE m: mean / median / 95 %", ".3f", "position_rmse_m_mean position_rmse_m_median position_rmse_m_p95"),
    ("heading rad", ".4f", "heading_rmse_rad_mean"),
    ("found %", ".0f", "success_percent"),
    ("after readings: median / 95 %", ".0f", "readings_to_converge_median readings_to_converge_p95"),
    ("expected m / rad", ".6f", "expected_range_m_mean expected_bearing_rad_mean"),
    ("printed", ".6f", "printed_range_m printed_bearing_rad"),
)

STUDY = Study(
    about="LANDMARK on a real robot's log: filters, particles, models, starts, and readings that are missing",
    trials=20,
    settings=LandmarkSettings,
    tasks=tasks,
    run_task=run_task,
    rows=_rows,
    columns=_COLUMNS,
    figures=_figures,
)
