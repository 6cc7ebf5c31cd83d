"""A scenario run in this process into a recording, as studies, references and tests do it."""

from collections.abc import Callable
from pathlib import Path

from dynpf_formats.recording.writer import RecordingWriter
from dynpf_runtime.inline import run_inline
from dynpf_runtime.plan import run_header

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.recorded import attachments_of
from dynpf_services.scenario.schema import Scenario

__all__ = ["record_inline"]


def record_inline(
    scenario: Scenario,
    path: Path,
    log: PlayedLog | None = None,
    *,
    stopped: Callable[[], str] = lambda: "",
) -> int:
    """Run ``scenario`` to its end into a new recording at ``path`` and return the number of ticks.

    ``log`` is what the sensors play, if they play one. ``stopped`` is asked before each tick for a reason why it shall
    be the last. Raises what the nodes raise; the recording then holds what came before, and says that it is incomplete.
    """
    plan = plan_of(scenario)
    attachments = attachments_of(scenario, log.attachments if log else ())
    with RecordingWriter(path, run_header(plan), attachments, topics=plan.graph.topics) as writer:
        ticks = run_inline(plan, log.records if log else [], writer, stopped=lambda: bool(stopped()))
        writer.close(complete=True, reason=stopped() or "finished")
    return ticks
