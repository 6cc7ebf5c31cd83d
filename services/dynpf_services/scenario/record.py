"""Runs a scenario in this process into a recording, for studies, references and tests."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.errors import UsageError
from dynpf_runtime.inline import Observer, run_inline
from dynpf_runtime.plan import run_header
from dynpf_runtime.source import LogRecord

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.recorded import attachments_of
from dynpf_services.scenario.schema import Scenario

__all__ = ["Log", "LogContent", "check_log", "record_inline"]


class Log(Protocol):
    """The log that the sensors of a run play, and its attachments for the run's recording."""

    @property
    def records(self) -> Iterable[LogRecord]:
        """The records in file order."""

    @property
    def attachments(self) -> Sequence[Attachment]:
        """The attachments."""


class LogContent(NamedTuple):
    """A log in memory."""

    records: Iterable[LogRecord] = ()
    attachments: Sequence[Attachment] = ()


def check_log(scenario: Scenario, log: Path | None) -> None:
    """Raise UsageError if the scenario plays a log and none is given, or the other way round."""
    if scenario.needs_log and log is None:
        raise UsageError("this scenario plays an imported log: give it with --log IN.mcap (dynpf import makes one)")
    if log is not None and not scenario.needs_log:
        raise UsageError(f"--log {log}: this scenario plays no log")


def record_inline(
    scenario: Scenario,
    path: Path,
    log: Log | None = None,
    *,
    observe: Observer | None = None,
    stopped: Callable[[], str] = lambda: "",
    reason: str = "finished",
    durable: bool = False,
    acts: Mapping[int, Sequence[LogRecord]] = {},
) -> int:
    """Run ``scenario`` to its end into a new recording at ``path`` and return the number of ticks.

    ``log`` is the log that the sensors play, if any. ``stopped`` is called before each tick and returns a reason to
    make it the last, or an empty text; the recording's end has that reason, or else ``reason``. A ``durable`` recording
    survives a loss of power, all but its last moments. ``acts`` has what a person does, by tick. Raises whatever the
    nodes raise; the recording then holds everything before, and is marked as incomplete.
    """
    log = log or LogContent()
    plan = plan_of(scenario)
    attachments = attachments_of(scenario, log.attachments)
    with RecordingWriter(path, run_header(plan), attachments, topics=plan.graph.topics, durable=durable) as writer:
        run = run_inline(plan, log.records, writer, observe=observe, stopped=lambda: bool(stopped()), acts=acts)
        writer.close(complete=True, reason=stopped() or reason, outcome=run.outcome)
    return run.ticks
