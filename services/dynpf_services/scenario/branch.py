"""What if: a recorded run as it was up to a moment, and from there on with other settings or another node."""

from collections.abc import Container, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.seek import Moment
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.regular_files import readable
from dynpf_protocol.errors import UsageError
from dynpf_runtime.branch import branch
from dynpf_runtime.plan import Plan, run_header

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import acts_of, log_records
from dynpf_services.scenario.recorded import attachments_of
from dynpf_services.scenario.replay import scenario_of_replay
from dynpf_services.scenario.replay_part import absolute
from dynpf_services.scenario.schema import Scenario

__all__ = ["Branched", "branch_run", "exchange"]


class Branched(NamedTuple):
    """The first tick of the branch, the nodes that are others in it, and those of them that began there anew."""

    at: int
    changed: tuple[str, ...]
    fresh: tuple[str, ...]


def exchange(text: str) -> str:
    """Return the setting that exchanges a node, which ``NODE=package.module:Class`` names; raises UsageError."""
    node, equals, name = text.partition("=")
    if not (node and equals and ":" in name) or '"' in name:
        raise UsageError(f"--node {text}: expected a node and a class of yours, such as estimator=mylab:Mine")
    return f'{node}={{kind="{name}"}}'


def branch_run(
    recording: Recording, at: Moment, overrides: Sequence[str], allow_code: Container[str], path: Path
) -> Branched:
    """Write the branched run into a new recording at ``path``.

    Raises UsageError for a realtime run and for settings that cannot change in mid-run, ScenarioError for settings that
    do not fit, RunError if the nodes do not do again what they did before the branch.
    """
    was = scenario_of_replay(recording, allow_code=allow_code)
    scenario = scenario_of_replay(recording, overrides=overrides, allow_code=allow_code)
    _check_branches(was, scenario)
    # The chains of a recording begin with the text that is in it, which another version may have resolved.
    before, after = plan_of(was)._replace(text=recording.header.scenario), plan_of(scenario)
    changed = tuple(name for name in scenario.nodes if _is_other(was, scenario, name))
    tick = _tick(recording, before, at)
    attachments = attachments_of(scenario, recording.attachments)
    topics, schemas = after.graph.topics, recording.schemas
    with RecordingWriter(path, run_header(after), attachments, topics=topics, schemas=schemas) as writer:
        made = branch(
            recording,
            before,
            (after, changed),
            tick,
            log=log_records(recording),
            acts=acts_of(recording),
            writer=writer,
        )
        reason = f"branched at tick {tick} from {readable(recording.path.name)}"
        writer.close(complete=True, reason=reason, outcome=made.ran.outcome)
    return Branched(tick, changed, made.fresh)


def _check_branches(was: Scenario, scenario: Scenario) -> None:
    if was.clock != "lockstep" or scenario.clock != "lockstep":
        raise UsageError("a realtime run cannot go on from its middle: only a lockstep run can be branched")
    if [*was.nodes] != [*scenario.nodes]:
        raise UsageError("a branch has the nodes of the run; only their settings, and what they are, may change")
    if was.tick_s != scenario.tick_s:
        raise UsageError("--set tick_s: the length of a tick cannot change in mid-run")


def _is_other(was: Scenario, scenario: Scenario, name: str) -> bool:
    """Return whether a node is configured otherwise in a scenario, or of another kind."""
    pairs = [(one.kinds[name], msgspec.to_builtins(one.nodes[name], enc_hook=repr)) for one in (was, scenario)]
    return pairs[0] != pairs[1]


def _tick(recording: Recording, plan: Plan, at: Moment) -> int:
    """Return the first tick that is not before a moment; raises UsageError after the end of the run."""
    moment = absolute(at, recording, plan)
    source = plan.graph.source
    for node, boot in recording.journals():
        if node == source:
            for entry in recording.journal(node, boot):
                if not moment.after(entry):
                    return entry.tick
    raise UsageError(f"{recording.path}: the run has ended before that moment; nothing to branch")
