"""Finds the settings that make two lockstep runs differ, by running A's scenario with some of B's settings."""

import sys
from collections.abc import Container, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from dynpf_formats.recording.attachments import FOLDER, is_file
from dynpf_formats.recording.diff import FirstDifference, diff, order_of
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.errors import RunError, ScenarioError
from dynpf_runtime.progress import show_progress
from dynpf_runtime.simulation.shrink import shrunk
from dynpf_services.scenario.played_log import log_records
from dynpf_services.scenario.record import LogContent, record_inline
from dynpf_services.scenario.recorded import described_scenario
from dynpf_services.scenario.user_code import check_allowed

from dynpf_experiments.bisect.settings import LOG, Change, changes, mixed, settings_of

__all__ = ["Cause", "Found", "search"]

_WHOLE = sys.maxsize


class Cause(NamedTuple):
    """The settings, none of which can be left out, without which B's run would differ here from what it is."""

    settings: tuple[Change, ...]
    difference: FirstDifference


class Found(NamedTuple):
    """What came of a search.

    ``a_again`` and ``b_again`` are the first differences of the runs from what this installation makes of their
    settings, None for a run that is reproduced. ``rest`` is the first difference that stays with the settings of all
    causes; None if these settings alone make A's run B's, byte for byte. ``executed`` is the number of runs.
    """

    settings: tuple[Change, ...]
    a_again: FirstDifference | None
    b_again: FirstDifference | None
    causes: tuple[Cause, ...]
    rest: FirstDifference | None
    executed: int

    @property
    def without_effect(self) -> tuple[Change, ...]:
        """The settings that are no cause."""
        named = {change.path for cause in self.causes for change in cause.settings}
        return tuple(change for change in self.settings if change.path not in named)


def search(a: Recording, b: Recording, allow_code: Container[str] = ()) -> Found:
    """Find the causes in the order in which they show; of each run the same installation executes all.

    Raises ScenarioError if one of the runs cannot be executed here, and for user code that is not allowed; RunError if
    a node of it raises.
    """
    with TemporaryDirectory(prefix="dynpf-") as folder:
        runs = _Runs(a, b, allow_code, Path(folder))
        # What is found concerns what this installation makes of the settings, also where the runs were made by another.
        target = runs.made(runs.settings)
        base: tuple[Change, ...] = ()
        now = runs.made(base)
        a_again, b_again = diff(a, now).first, diff(b, target).first
        nodes = target.header.writes
        causes: list[Cause] = []
        while (first := diff(now, target).first) is not None and len(base) < len(runs.settings):
            found = runs.cause(base, target, first, tuple(nodes))
            causes.append(Cause(found, first))
            base = (*base, *found)
            now = runs.made(base)
        show_progress("")
        return Found(runs.settings, a_again, b_again, tuple(causes), first, runs.executed)


class _Runs:
    """Executes A's scenario with some of B's settings."""

    def __init__(self, a: Recording, b: Recording, allow_code: Container[str], folder: Path) -> None:
        self._a, self._b, self._allow_code, self._folder = a, b, allow_code, folder
        self._raw, other = (settings_of(run.header.scenario, str(run.path)) for run in (a, b))
        self.settings = changes(self._raw, other)
        self.executed = 0

    def made(self, chosen: Iterable[Change], ticks: int = _WHOLE) -> Recording:
        """Return the run with B's values of the chosen settings, up to a number of ticks."""
        chosen = tuple(chosen)
        self.executed += 1
        show_progress(f"run {self.executed}: {len(chosen)} of {len(self.settings)} settings")
        played = self._b if any(change.path == (LOG,) for change in chosen) else self._a
        attachments = self._attachments(chosen, played)
        where = f"{self._a.path} with settings of {self._b.path.name}"
        text = mixed(self._raw, chosen)
        scenario = described_scenario(text, attachments, where, allow_code=self._allow_code)
        check_allowed(scenario.user_classes, scenario.user_code, str(self._a.path))
        begun = iter(range(_WHOLE))
        path = self._folder / f"{self.executed}.mcap"
        log = LogContent(log_records(played), attachments)
        record_inline(scenario, path, log, stopped=lambda: "cut" if next(begun) + 1 >= ticks else "")
        return read_recording(path)

    def _attachments(self, chosen: Sequence[Change], played: Recording) -> tuple[Attachment, ...]:
        """Return the files that the scenario names, each of the run whose setting it is, and those of the log."""
        others = {f"{FOLDER}{change.path[1]}" for change in chosen if change.path[0] == "files" and change.path[1:]}
        return (
            *(item for item in self._a.attachments if is_file(item) and item.name not in others),
            *(item for item in self._b.attachments if item.name in others),
            *(item for item in played.attachments if not is_file(item)),
        )

    def cause(
        self, base: Sequence[Change], target: Recording, first: FirstDifference, nodes: Sequence[str]
    ) -> tuple[Change, ...]:
        """Return as few settings as let the run go on beyond its first difference as B's does."""
        place = order_of(first, nodes)
        # Of a run only what is up to the difference counts; which steps there are is known at its end alone.
        ticks = _WHOLE if first.tick is None or place[0] else first.tick + 2
        known = {change.path for change in base}

        def agrees(chosen: Sequence[Change]) -> bool:
            try:
                made = self.made((*base, *chosen), ticks)
            except (ScenarioError, RunError):
                return False  # settings that only fit together
            difference = diff(made, target).first
            return difference is None or order_of(difference, nodes) > place

        return shrunk([change for change in self.settings if change.path not in known], agrees)
