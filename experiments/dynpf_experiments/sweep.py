"""A study as a table: a scenario, the keys of it that vary, and the measures of each run."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dynpf_protocol.errors import UsageError
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.overrides import overrides_of
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import check_log
from dynpf_services.scenario.user_code import add_folders, code_folders

from dynpf_experiments.drive import drive
from dynpf_experiments.measures import measure_run, measured_topics
from dynpf_experiments.messages import RunMessages
from dynpf_experiments.rows import Sample, summarized
from dynpf_experiments.study import Study
from dynpf_experiments.sweep_figures import draw

__all__ = ["sweep"]

Measure = Callable[[RunMessages], float | bool]


class _Asked(NamedTuple):
    """What all trials share: the scenario, and the measures by name or as functions of the user's."""

    scenario: str
    measures: Mapping[str, str | Measure]
    topics: tuple[str, ...]
    log: str | None
    code: tuple[Path, ...]


class _Task(NamedTuple):
    """A run. The ``first`` must have all measures given by name, so that a wrong name is reported at once."""

    factors: Mapping[str, Any]
    seed: int
    first: bool


def sweep(
    *,
    scenario: str | Path,
    grid: Mapping[str, Sequence[Any]],
    measures: Sequence[str] | Mapping[str, str | Measure],
    trials: int = 10,
    about: str = "",
    topics: Sequence[str] = (),
    log: str | Path | None = None,
    code: Sequence[str | Path] = (),
) -> Study:
    """Return the study that runs ``scenario`` with each combination of settings and each seed, and measures the runs.

    ``grid`` has the values of each key of the scenario that varies. ``measures`` are names of ``dynpf metrics``, with
    the name of one of several estimators in front (``pf.position_rmse_m``); or a mapping of labels to such names and to
    functions of the run's messages, which may need ``topics`` besides those of the measures by name. A bool counts as a
    share of the trials, NaN is left out. Trial ``k`` has the seed of the study plus ``k`` for all settings; each run
    equals that of ``dynpf run``, byte for byte. ``log`` is an imported log that the sensors play, ``code`` are folders
    with modules of yours.
    """
    chosen: Mapping[str, str | Measure] = (
        measures if isinstance(measures, Mapping) else {name: name for name in measures}
    )
    if not chosen:
        raise UsageError("a sweep needs measures: name some of those that dynpf metrics prints")
    if empty := [key for key, values in grid.items() if not values]:
        raise UsageError(f"{empty[0]} has no values; expected one or more")
    asked = _Asked(str(scenario), chosen, tuple(topics), None if log is None else str(log), tuple(map(Path, code)))
    return Study(
        about=about or f"{Path(scenario).stem} by {', '.join((*grid, 'seed'))}",
        trials=trials,
        settings=_settings(grid),
        tasks=_tasks,
        run_task=partial(_run, asked),
        rows=summarized,
        figures=lambda _settings, _seed, rows, folder: draw(rows, tuple(grid), folder),
    )


def _settings(grid: Mapping[str, Sequence[Any]]) -> type[msgspec.Struct]:
    """Return the settings of the study: the values of each key."""
    names = {f"factor_{index}": key for index, key in enumerate(grid)}
    fields = [(name, tuple[Any, ...], tuple(grid[key])) for name, key in names.items()]
    return msgspec.defstruct("Grid", fields, frozen=True, kw_only=True, forbid_unknown_fields=True, rename=names)


def _tasks(settings: msgspec.Struct, trials: int, seed: int) -> list[_Task]:
    grid: dict[str, list[Any]] = msgspec.to_builtins(settings)
    combined = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    every = [(factors, seed + trial) for trial in range(trials) for factors in combined]
    return [_Task(factors, number, index == 0) for index, (factors, number) in enumerate(every)]


def _run(asked: _Asked, task: _Task) -> list[Sample]:
    add_folders(code_folders(asked.code, asked.scenario))
    log = _played(asked.log) if asked.log else None
    scenario = load_scenario(
        asked.scenario, overrides=overrides_of(task.factors), seed=task.seed, log=log.facts if log else None
    )
    check_log(scenario, Path(asked.log) if asked.log else None)
    run = drive(scenario, {*measured_topics(scenario), *asked.topics}, log)
    found = _by_name(measure_run(run)) if any(isinstance(name, str) for name in asked.measures.values()) else {}
    measures: dict[str, float | bool] = {}
    for label, measure in asked.measures.items():
        if not isinstance(measure, str):
            measures[label] = measure(run)
            continue
        if task.first and measure not in found:
            there = ", ".join(found) or "none"
            raise UsageError(f"{asked.scenario}: its run has no measure {measure!r}; it has {there}")
        measures[label] = found.get(measure, math.nan)
    factors = {
        key: value if isinstance(value, int | float | str) else str(value) for key, value in task.factors.items()
    }
    return [Sample(factors, measures)]


@lru_cache(maxsize=1)
def _played(path: str) -> PlayedLog:
    return PlayedLog(Path(path))


def _by_name(measures: Mapping[str, Any], before: str = "") -> dict[str, float | bool]:
    """Return the measures that are numbers; with several estimators, those of each are called NAME.MEASURE."""
    found = {before + name: value for name, value in measures.items() if isinstance(value, bool | int | float)}
    for name, figures in measures.get("estimators", {}).items():
        found |= _by_name(figures, f"{name}.")
    return found
