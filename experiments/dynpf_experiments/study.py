"""Execution of a study as independent tasks, with the same result for any number of processes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from dynpf_protocol.errors import UsageError
from dynpf_runtime.progress import Share
from dynpf_services.scenario.overrides import value_of
from joblib import Parallel, delayed

from dynpf_experiments.rows import Row, Sample

__all__ = ["Study", "run_study", "settings_from"]

SettingsT = TypeVar("SettingsT", bound=msgspec.Struct)


class Study(msgspec.Struct, frozen=True, kw_only=True):
    """``tasks`` divides settings, trials and a seed into tasks; ``run_task`` executes a task, in any process.

    ``rows`` summarizes all samples; ``columns`` are those of its table (see ``as_table``), by default all; ``figures``
    draws into a folder, from settings, seed and rows, and returns the files.
    """

    about: str
    trials: int
    settings: type[msgspec.Struct]
    tasks: Callable[[Any, int, int], list[Any]]
    run_task: Callable[[Any], list[Sample]]
    rows: Callable[[list[Sample]], list[Row]]
    figures: Callable[[Any, int, list[Row], Path], list[Path]]
    columns: Sequence[tuple[str, str, str]] = ()


def settings_from(kind: type[SettingsT], overrides: Sequence[str]) -> SettingsT:
    """Return the default settings changed by ``KEY=VALUE``, with values in TOML or else strings.

    The keys of a sweep contain dots. Raises UsageError, which names the override.
    """
    chosen: dict[str, Any] = {}
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise UsageError(f"--set {override}: expected KEY=VALUE")
        chosen[key.strip()] = value_of(text)
    try:
        return msgspec.convert(chosen, kind)
    except msgspec.ValidationError as error:
        known = ", ".join(field.encode_name for field in msgspec.structs.fields(kind))
        raise UsageError(f"--set {' --set '.join(overrides)}: {error}; settings of this study: {known}") from error


def run_study(study: Study, settings: msgspec.Struct, trials: int, seed: int, jobs: int) -> list[Row]:
    """Return the rows of a study, which do not depend on the number of jobs."""
    tasks = study.tasks(settings, trials, seed)
    samples: list[Sample] = []
    with Share(len(tasks), "tasks") as progress:
        results = Parallel(jobs, return_as="generator")(delayed(study.run_task)(task) for task in tasks)
        for done, found in enumerate(results, start=1):
            samples += found
            progress.show(done)
    return study.rows(samples)
