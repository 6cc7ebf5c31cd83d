"""Runs in Python, for notebooks and scripts: ``run`` makes a run, ``read`` opens a recording, ``Run`` is its content.

They use the functions of the command line: a run is that of ``dynpf run --runner inline``, its metrics are those of
``dynpf metrics``, the columns of a topic those of ``dynpf export``, a replay that of ``dynpf replay``.
"""

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dynpf_experiments.extras import needing
from dynpf_experiments.measures import estimates_of, measure, summary, truth_of
from dynpf_experiments.messages import planar_poses, recorded
from dynpf_formats.exporters.table import header, message_of, rows
from dynpf_formats.recording.diff import FirstDifference, diff
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.regular_files import exists
from dynpf_protocol.errors import UsageError
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.messages import PosesInFrame
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.overrides import overrides_of
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import check_log, record_inline
from dynpf_services.scenario.replay import replay_nodes, rerun, scenario_of_replay, write_nodes
from dynpf_services.scenario.user_code import add_folders, code_folders
from numpy.typing import NDArray

from dynpf.types import FloatArray
from dynpf_lab.page import make_page
from dynpf_lab.plots import Plots

__all__ = ["Run", "TopicMessages", "read", "run"]

Arrays = dict[str, NDArray[Any]]


class TopicMessages:
    """The messages of a topic of a run, in the order of the file; they are read at their use."""

    def __init__(self, run: "Run", topic: str) -> None:
        self.run, self.topic = run, topic  # the run keeps its file

    @property
    def _recording(self) -> Recording:
        return self.run.recording

    def __len__(self) -> int:
        return sum(1 for _ in self._recording.messages(self.topic))

    def __iter__(self) -> Iterator[tuple[float, Any]]:
        """Yield logical times in seconds and messages; a message of an unknown type is a dictionary."""
        for record in self._recording.messages(self.topic):
            yield record.stamp_ns / 1e9, message_of(self._recording, self.topic, record.payload)

    def arrays(self) -> Arrays:
        """Return an array for each field of the T messages, (T,) or, for lists of the same length L, (T, L).

        The names are those of the columns of ``dynpf export --format csv``, including ``stamp_s``; the elements of a
        list of fixed length form an array. A missing number is NaN; other values, such as lists of tables, are objects.
        """
        names = header(self._recording, self.topic)
        values = list(zip(*rows(self._recording, self.topic), strict=True)) or [()] * len(names)
        found: Arrays = {}
        lists: dict[str, list[NDArray[Any]]] = {}
        for name, column in zip(names, values, strict=True):
            whole, _, position = name.rpartition(".")
            if position.isdecimal():
                lists.setdefault(whole, []).append(_array(column))
            else:
                found[name] = _array(column)
        return found | {name: np.stack(columns, axis=1) for name, columns in lists.items()}

    def frame(self) -> Any:
        """Return a pandas DataFrame with a row for each message, by ``stamp_s``, and a column for each field.

        Raises UsageError where pandas is not installed.
        """
        with needing("pandas", extra="frames", what="a data frame"):
            import pandas  # noqa: PLC0415
        names = header(self._recording, self.topic)
        return pandas.DataFrame(rows(self._recording, self.topic), columns=names).set_index("stamp_s")


def _array(values: Collection[Any]) -> NDArray[Any]:
    """Return the values of a field: numbers, NaN for missing ones, lists of the same length as rows."""
    known = [value for value in values if value is not None]
    if all(isinstance(value, bool) for value in known) and len(known) == len(values):
        return np.array(known, dtype=bool)
    if all(isinstance(value, int) for value in known) and len(known) == len(values):
        return np.array(known, dtype=np.int64)
    if all(isinstance(value, int | float) for value in known):
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if all(isinstance(value, str) for value in values):
        return np.array(values, dtype=np.str_)
    if all(_is_list_of_numbers(value) for value in values) and len({len(value) for value in values}) == 1:
        return np.array(values, dtype=np.float64)
    found = np.empty(len(values), dtype=object)
    found[:] = list(values)
    return found


def _is_list_of_numbers(value: Any) -> bool:
    return isinstance(value, tuple | list) and all(isinstance(number, int | float) for number in value)


class Cloud(NamedTuple):
    """Published particles: their logical time, s, and poses (3, M)."""

    stamp_s: float
    poses: FloatArray


class Run:
    """A recorded run: ``run[topic]`` has the messages of a topic, ``print(run)`` prints its measures."""

    def __init__(self, path: str | Path) -> None:
        self.recording = read_recording(path)
        self._messages = recorded(self.recording)

    @property
    def path(self) -> Path:
        """The file."""
        return self.recording.path

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics with messages, without the journals."""
        return tuple(sorted(name for name in self.recording.schemas if not name.startswith(JOURNAL_PREFIX)))

    def __getitem__(self, topic: str) -> TopicMessages:
        """Return the messages of a topic; raises UsageError, which lists the topics of the run."""
        if topic not in self.recording.schemas:
            raise UsageError(f"{self.path}: nothing on {topic}; it has {', '.join(self.topics) or 'no messages'}")
        return TopicMessages(self, topic)

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """The measures of ``dynpf metrics --json``; those of several estimators are in ``["estimators"]``."""
        return measure(self.recording)

    @property
    def digest(self) -> str:
        """The content digest, which is equal for equal runs."""
        return content_digest(self.recording)

    @property
    def truth(self) -> TopicMessages:
        """The truth, simulated or a log's reference; raises UsageError without a truth."""
        topic = truth_of(self._messages)
        if topic is None:
            raise UsageError(f"{self.path}: holds no truth; it has {', '.join(self.topics)}")
        return self[topic]

    @property
    def estimators(self) -> tuple[str, ...]:
        """The names of the nodes with estimates."""
        return tuple(topic.rpartition("/")[0] for topic in estimates_of(self._messages))

    def estimates(self, estimator: str | None = None) -> TopicMessages:
        """Return the estimates of an estimator, which must be named if there are several.

        Raises UsageError for an ambiguous or unknown estimator.
        """
        topics = dict(zip(self.estimators, estimates_of(self._messages), strict=True))
        if estimator is None and len(topics) == 1:
            (estimator,) = topics
        if estimator not in topics:
            asked = "has several estimators" if estimator is None else f"has no estimator {estimator}"
            raise UsageError(f"{self.path}: {asked}; name one of {', '.join(topics) or 'none'}")
        return self[topics[estimator]]

    def health(self, estimator: str | None = None) -> Arrays:
        """Return an estimator's verdicts: ``stamp_s``, ``status``, ``reason``, ``figures.mode_mass`` and so on."""
        found = self.estimates(estimator).arrays()
        own = {name.removeprefix("health."): array for name, array in found.items() if name.startswith("health.")}
        return {"stamp_s": found["stamp_s"], **own}

    def particles(self, estimator: str | None = None) -> Iterator[Cloud]:
        """Yield the published particles of an estimator: x, y (m) and theta (rad)."""
        topic = self.estimates(estimator).topic.rpartition("/")[0] + "/particles"
        for stamp_s, message in self[topic]:
            assert isinstance(message, PosesInFrame)
            yield Cloud(stamp_s, planar_poses(message.poses))

    def replay(
        self,
        node: str | None = None,
        settings: Mapping[str, Any] | None = None,
        path: str | Path | None = None,
        allow_code: Collection[str] = (),
    ) -> "Run":
        """Execute the run again, as ``dynpf replay`` does, and return the new run.

        With ``node`` only that node is executed, else each, on its recorded inputs; with ``settings`` and no node the
        whole run is repeated from its source. ``path`` is the recording to be written, by default a temporary file that
        is removed with the Run. ``allow_code`` names the modules of yours that the recording may run.

        Raises ScenarioError for settings that do not fit, UsageError for an unknown node.
        """
        overrides = overrides_of(settings or {})
        scenario = scenario_of_replay(self.recording, node, overrides, allow_code)

        def make(target: Path) -> None:
            """Write the recording of the new run."""
            if overrides and node is None:
                rerun(self.recording, scenario, target)
            else:
                outcomes = replay_nodes(self.recording, scenario, node, keep=True)
                write_nodes(self.recording, scenario, outcomes, target)

        return _made(path, make)

    def difference(self, other: "Run") -> FirstDifference | None:
        """Return the first message or state in which another run differs, None if they are equal."""
        return diff(self.recording, other.recording).first

    def page(self, path: str | Path) -> Path:
        """Write the page of ``dynpf view`` and return its path; raises UsageError for a file that is no such page."""
        make_page([self.recording], Path(path), self.metrics)
        return Path(path)

    @cached_property
    def plot(self) -> Plots:
        """The figures of ``dynpf plot``: ``run.plot.trajectory()``."""
        return Plots(lambda: self.recording)

    def __str__(self) -> str:
        return summary(self.recording, self.metrics)


def run(
    scenario: str | Path,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    path: str | Path | None = None,
    *,
    log: str | Path | None = None,
    code: Iterable[str | Path] = (),
) -> Run:
    """Run a scenario in this process, as ``dynpf run --runner inline`` does, and return the recorded run.

    ``scenario`` is the name of a scenario of dynpf, or a TOML file; ``settings`` maps its keys to values, such as
    ``{"estimator.n": 200}``. ``path`` is the recording to be written, by default a temporary file that is removed with
    the Run. ``log`` is an imported log that the sensors play, ``code`` are folders with modules of yours.

    Raises ScenarioError for a scenario or settings that do not fit, UsageError for an existing file, and StepError for
    what a node raises.
    """
    add_folders(code_folders(map(Path, code), str(scenario)))
    played = PlayedLog(Path(log)) if log is not None else None
    facts = played.facts if played else None
    resolved = load_scenario(str(scenario), overrides=overrides_of(settings or {}), seed=seed, log=facts)
    check_log(resolved, Path(log) if log is not None else None)
    if resolved.clock != "lockstep":
        raise UsageError(f"{scenario}: a realtime run needs processes of its own: dynpf run, then read its recording")
    return _made(path, lambda target: record_inline(resolved, target, played))


def read(path: str | Path) -> Run:
    """Return the run in a recording; raises a RecordingError that describes faults of the file."""
    return Run(path)


def _made(path: str | Path | None, make: Callable[[Path], object]) -> Run:
    """Return the run whose recording ``make`` writes: to ``path``, or to a temporary file removed with the Run."""
    if path is not None:
        if exists(Path(path)):
            raise UsageError(f"{path}: the file exists; choose another name")
        make(Path(path))
        return Run(path)
    folder = Path(tempfile.mkdtemp(prefix="dynpf-"))
    try:
        make(folder / "run.mcap")
        made = Run(folder / "run.mcap")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(made, _remove, folder, os.getpid())
    return made


def _remove(folder: Path, owner: int) -> None:
    """Remove a temporary folder, unless this is only a copy, by a fork, of the process that made it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
