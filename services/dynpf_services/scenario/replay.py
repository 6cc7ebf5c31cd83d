"""Executes a recorded run again: each node by itself on its recorded inputs, or the whole run from its source."""

import json
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_formats.recording.doctor import altered
from dynpf_formats.recording.findings import Finding, error
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_formats.regular_files import readable
from dynpf_protocol.errors import UsageError
from dynpf_runtime.plan import run_header, written_topics
from dynpf_runtime.replay import Mismatch, Replayed, replay_node, write_replayed
from dynpf_runtime.replay_hosts import replay_hosts

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import acts_of, log_records
from dynpf_services.scenario.record import LogContent, record_inline
from dynpf_services.scenario.recorded import attachments_of, recorded_scenario
from dynpf_services.scenario.schema import Scenario, key_of, resolved_json
from dynpf_services.scenario.user_code import check_allowed

__all__ = ["ChangedModule", "changed_code", "check_run", "replay_nodes", "rerun", "scenario_of_replay", "write_nodes"]


class ChangedModule(NamedTuple):
    """A user module whose source differs from that of the recorded run, with both digests."""

    module: str
    recorded: str
    digest: str


def scenario_of_replay(
    recording: Recording, node: str | None = None, overrides: Sequence[str] = (), allow_code: Container[str] = ()
) -> Scenario:
    """Return the scenario of a recording for a replay of one node, or of all.

    Raises ScenarioError as ``recorded_scenario`` does, and for user code that is not allowed; UsageError for a node
    that is not in the run.
    """
    scenario = recorded_scenario(recording, overrides, allow_code)
    named = scenario.user_classes
    if node is not None:
        named = tuple(user for user in named if user.key.startswith(f"{key_of(node)}."))
    check_allowed(named, scenario.user_code, str(recording.path))
    if node is not None and node not in scenario.nodes:
        raise UsageError(f"{recording.path}: has no node {node!r}; its nodes are {', '.join(scenario.nodes)}")
    if node is not None:
        _check_concerns(node, overrides, scenario)
    return scenario


def _check_concerns(node: str, overrides: Sequence[str], scenario: Scenario) -> None:
    """Refuse settings of other nodes, which cannot reach one that is replayed by itself, on its recorded inputs."""
    others = {key_of(other): other for other in scenario.nodes if other != node}
    for override in overrides:
        key = override.partition("=")[0]
        for other, name in others.items():
            if key == other or key.startswith(f"{other}."):
                raise UsageError(
                    f"--set {override}: a setting of {name} does not reach {node}, which is replayed on its recorded "
                    "inputs; without --node the whole run is executed again"
                )


def changed_code(recording: Recording, scenario: Scenario) -> Iterator[ChangedModule]:
    """Yield the user modules whose source has changed since the recorded run."""
    recorded = _recorded_digests(recording)
    for module, digest in scenario.user_code.items():
        if (then := recorded.get(module)) not in (None, digest):
            yield ChangedModule(module, then, digest)


def _recorded_digests(recording: Recording) -> dict[str, str]:
    """Return the digests of the user modules of the recorded run, by module."""
    return json.loads(recording.header.scenario).get("user_code") or {}


def replay_nodes(recording: Recording, scenario: Scenario, node: str | None, *, keep: bool) -> list[Replayed]:
    """Replay one node, or each by itself, and return the results; see ``replay_node``."""
    plan = plan_of(scenario)
    return [replay_node(recording, plan, name, keep=keep) for name in ((node,) if node else plan.graph.nodes)]


def check_run(recording: Recording, scenario: Scenario) -> tuple[list[Finding], Mismatch | None]:
    """Return why a recording is not what its recorder wrote, and the first step whose inputs are not those of its run.

    ``scenario`` is the recorded one, without overrides. Where code that it names is not allowed, it is not known what
    every node writes and reads, and so neither is compared.
    """
    plan = plan_of(scenario)
    findings = altered(recording)
    known = all(user.module in scenario.user_code for user in scenario.user_classes)
    planned = {"seed": plan.seed, "clock": plan.clock, **({"writes": written_topics(plan)} if known else {})}
    for field, value in planned.items():
        if getattr(recording.header, field) != value:
            findings.append(error(f"{field} is not that of the scenario", "metadata run"))
    return findings, next(replay_hosts(recording, plan), None) if known else None


def write_nodes(recording: Recording, scenario: Scenario, outcomes: Sequence[Replayed], path: Path) -> None:
    """Write a recording of the run in which the kept results of replayed nodes replace the recorded ones."""
    recorded = _recorded_digests(recording)
    # Code that was not executed now keeps its recorded digest in the text alone: in the scenario itself it would allow
    # the import.
    unexecuted = {user.module: digest for user in scenario.user_classes if (digest := recorded.get(user.module))}
    described = msgspec.structs.replace(scenario, user_code={**unexecuted, **scenario.user_code})
    plan = plan_of(scenario)._replace(text=resolved_json(described))
    attachments = attachments_of(scenario, recording.attachments)
    topics, schemas = plan.graph.topics, recording.schemas
    with RecordingWriter(path, run_header(plan), attachments, topics=topics, schemas=schemas) as writer:
        write_replayed(recording, outcomes, writer)
        end = recording.end
        whole, outcome = (end.complete, end.outcome) if end is not None else (False, "")
        writer.close(complete=whole, reason=f"replayed from {readable(recording.path.name)}", outcome=outcome)


def rerun(recording: Recording, scenario: Scenario, path: Path) -> None:
    """Run the whole run again from its source into a new recording, with the settings of ``scenario``.

    Raises UsageError for a realtime run, and whatever the nodes raise.
    """
    if scenario.clock != "lockstep":
        raise UsageError(
            "a realtime run cannot be run again from its source; choose --node to change one node's settings"
        )
    log = LogContent(log_records(recording), recording.attachments)
    record_inline(scenario, path, log, acts=acts_of(recording), reason=f"run anew from {readable(recording.path.name)}")
