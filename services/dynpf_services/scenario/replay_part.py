"""Executes a part of a recorded run again, from snapshots, and reads no more of the file than that needs."""

from collections.abc import Container, Sequence
from pathlib import Path
from time import process_time
from typing import NamedTuple

from dynpf_formats.recording.findings import Finding
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_formats.recording.seek import Indexed, Moment, NoIndexError
from dynpf_protocol.errors import UsageError
from dynpf_runtime.node import Rehearsing
from dynpf_runtime.plan import Plan
from dynpf_runtime.replay import Mismatch, Replayed, Span, replay_node
from dynpf_runtime.replay_part import ReplayedPart, replay_part

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.replay import check_run, scenario_of_replay
from dynpf_services.scenario.schema import Scenario

__all__ = ["Part", "absolute", "moment_of", "rehearse_nodes", "replay_parts", "speed_of"]


class Part(NamedTuple):
    """The part of a run that was executed again, node by node.

    ``recording`` has at least the head and the end of the file. ``unread`` says why the file was read as a whole after
    all, or is empty; only then it was checked as a whole, too, with these ``findings`` and this first difference of the
    hosts' ``inputs``. ``processor_s`` is the time that it took to execute and compare, without reading and preparing.
    """

    recording: Recording
    scenario: Scenario
    nodes: tuple[ReplayedPart, ...]
    processor_s: float
    unread: str = ""
    findings: tuple[Finding, ...] = ()
    inputs: Mismatch | None = None


def moment_of(text: str) -> Moment:
    """Return the moment that ``120s`` or ``tick:500`` names; seconds count from the run's first step.

    Raises UsageError for anything else.
    """
    unit, value = ("tick", text[5:]) if text.startswith("tick:") else ("ns", text.removesuffix("s"))
    try:
        number = int(value) if unit == "tick" else round(float(value) * 1e9)
    except (ValueError, OverflowError):
        number = -1
    if not 0 <= number < 2**63 or (unit == "ns" and not text.endswith("s")):
        raise UsageError(f"{text!r}: expected a time such as 120s, or a tick such as tick:500")
    return Moment(unit, number)


def replay_parts(
    path: Path, node: str | None, first: Moment | None, last: Moment | None, allow_code: Container[str]
) -> Part:
    """Replay one node, or each by itself, from the moment ``first`` to the moment ``last``.

    A file that has no index, or a wrong one, is read and checked as a whole, as far as it goes. Raises ScenarioError
    and UsageError as ``scenario_of_replay`` does, RecordingError.
    """
    if first is not None and last is not None and first.unit == last.unit and last.value < first.value:
        raise UsageError(f"{path}: the run has no step between these moments: the last is before the first")
    try:
        with Indexed(path) as indexed:
            part = _by_index(indexed, node, first, last, allow_code)
    except NoIndexError as error:
        part = _by_whole_file(path, node, first, last, allow_code)._replace(unread=str(error))
    if not any(replayed.outcome.steps for replayed in part.nodes):
        raise UsageError(f"{path}: the run has no step between these moments; dynpf info tells how long it is")
    return part


def _by_index(
    indexed: Indexed, node: str | None, first: Moment | None, last: Moment | None, allow_code: Container[str]
) -> Part:
    head = indexed.part(0, 0)
    scenario = scenario_of_replay(head, node, (), allow_code)
    plan = plan_of(scenario)
    first, last = (moment and absolute(moment, head, plan) for moment in (first, last))
    rehearse_nodes(plan, node)
    began_s = process_time()
    nodes = tuple(replay_part(indexed, plan, name, first, last) for name in _chosen(plan, node))
    return Part(head, scenario, nodes, process_time() - began_s)


def _by_whole_file(
    path: Path, node: str | None, first: Moment | None, last: Moment | None, allow_code: Container[str]
) -> Part:
    recording = read_recording(path, allow_truncated=True)
    scenario = scenario_of_replay(recording, node, (), allow_code)
    plan = plan_of(scenario)
    first, last = (moment and absolute(moment, recording, plan) for moment in (first, last))
    rehearse_nodes(plan, node)
    began_s = process_time()
    span = Span(None, first, last)
    nodes = tuple(ReplayedPart(replay_node(recording, plan, name, span=span), None) for name in _chosen(plan, node))
    processor_s = process_time() - began_s
    findings, inputs = check_run(recording, scenario)
    return Part(recording, scenario, nodes, processor_s, findings=tuple(findings), inputs=inputs)


def _chosen(plan: Plan, node: str | None) -> tuple[str, ...]:
    return (node,) if node else plan.graph.nodes


def absolute(moment: Moment, recording: Recording, plan: Plan) -> Moment:
    """Return a moment in the logical time of the run, which begins with its first step."""
    if moment.unit == "tick":
        return moment
    source = plan.graph.source
    boots = [boot for name, boot in recording.journals() if name == source]
    begun = next(recording.journal(source, boots[0]), None) if boots else None
    return moment._replace(value=moment.value + (0 if begun is None else begun.stamp_ns))


def rehearse_nodes(plan: Plan, node: str | None) -> None:
    """Load the kernels of one node, or of all, so that the time of its steps is known without that."""
    for name in _chosen(plan, node):
        built = plan.graph.specs[name].build()
        if isinstance(built, Rehearsing):
            built.rehearse()


def speed_of(outcomes: Sequence[Replayed], processor_s: float) -> float:
    """Return how many times faster than in the run these nodes were executed, one after another on one core."""
    total_ns = 0
    for outcome in outcomes:
        total_ns += outcome.duration_ns  # of a part each node has its own
    return total_ns / max(1, len(outcomes)) / 1e9 / max(processor_s, 1e-6)
