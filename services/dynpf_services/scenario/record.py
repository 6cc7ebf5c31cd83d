"""A scenario run in this process, into a recording or before an observer, as studies, references and tests do it."""

from collections.abc import Callable, Iterable, Sequence
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
    """What the sensors of a run play, and what of the log's attachments goes into the run's recording."""

    @property
    def records(self) -> Iterable[LogRecord]: ...

    @property
    def attachments(self) -> Sequence[Attachment]: ...


class LogContent(NamedTuple):
    """A log by its content."""

    records: Iterable[LogRecord] = ()
    attachments: Sequence[Attachment] = ()


def check_log(scenario: Scenario, log: Path | None) -> None:
    """Raise UsageError where the scenario plays a log and there is none, or the other way round."""
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
) -> int:
    """Run ``scenario`` to its end into a new recording at ``path`` and return the number of ticks.

    ``log`` is what the sensors play, if they play one. ``stopped`` is asked before each tick for a reason why it shall
    be the last; else the recording says ``reason``. Raises what the nodes raise; the recording then holds what came
    before, and says that it is incomplete.
    """
    log = log or LogContent()
    plan = plan_of(scenario)
    attachments = attachments_of(scenario, log.attachments)
    with RecordingWriter(path, run_header(plan), attachments, topics=plan.graph.topics) as writer:
        ticks = run_inline(plan, log.records, writer, observe=observe, stopped=lambda: bool(stopped()))
        writer.close(complete=True, reason=stopped() or reason)
    return ticks
