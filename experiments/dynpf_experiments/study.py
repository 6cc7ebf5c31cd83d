"""How a study is run: as tasks that know nothing of one another, so that it is the same on any number of processes."""

import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from dynpf_protocol.errors import UsageError
from joblib import Parallel, delayed

from dynpf_experiments.rows import Row, Sample

__all__ = ["Study", "run_study", "settings_from"]

SettingsT = TypeVar("SettingsT", bound=msgspec.Struct)


class Study(msgspec.Struct, frozen=True, kw_only=True):
    """``tasks`` divides settings, trials and a seed into tasks; ``run_task`` carries one out, in any process.

    ``rows`` summarizes all samples; ``columns`` are those of its table (see ``as_table``), all where none are named;
    ``figures`` draws into a folder, from settings, seed and rows, and returns what it wrote.
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
    """Return the settings that ``KEY=VALUE``, values as in TOML or else strings, make of the defaults.

    Raises UsageError, which names the override.
    """
    chosen: dict[str, Any] = {}
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise UsageError(f"--set {override}: expected KEY=VALUE")
        try:
            chosen[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            chosen[key.strip()] = text
    try:
        return msgspec.convert(chosen, kind)
    except msgspec.ValidationError as error:
        known = ", ".join(field.encode_name for field in msgspec.structs.fields(kind))
        raise UsageError(f"--set {' --set '.join(overrides)}: {error}; settings of this study: {known}") from error


def run_study(study: Study, settings: msgspec.Struct, trials: int, seed: int, jobs: int) -> list[Row]:
    """Return the rows of a study; the same for any number of jobs."""
    tasks = study.tasks(settings, trials, seed)
    samples: list[Sample] = []
    _show(0, len(tasks))
    for done, found in enumerate(
        Parallel(jobs, return_as="generator")(delayed(study.run_task)(task) for task in tasks)
    ):
        samples += found
        _show(done + 1, len(tasks))
    return study.rows(samples)


def _show(done: int, tasks: int) -> None:
    """Tell a person who watches how far it has come."""
    if sys.stderr.isatty():
        print(f"\r\033[K{done} of {tasks} tasks" if done < tasks else "\r\033[K", end="", file=sys.stderr, flush=True)
