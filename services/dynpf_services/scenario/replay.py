"""A recorded run executed again: each node by itself on its recorded inputs, or all of them anew from their source."""

import json
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_protocol.errors import UsageError
from dynpf_runtime.plan import run_header
from dynpf_runtime.replay import Replayed, replay_node, write_replayed

from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.played_log import log_records
from dynpf_services.scenario.record import LogContent, record_inline
from dynpf_services.scenario.recorded import attachments_of, recorded_scenario
from dynpf_services.scenario.schema import Scenario, key_of, resolved_json
from dynpf_services.scenario.user_code import check_allowed

__all__ = ["ChangedModule", "changed_code", "replay_nodes", "run_anew", "scenario_of_replay", "write_nodes"]


class ChangedModule(NamedTuple):
    """A module of the user's whose source is another than that of the recorded run: both digests."""

    module: str
    recorded: str
    digest: str


def scenario_of_replay(
    recording: Recording, node: str | None = None, overrides: Sequence[str] = (), allow_code: Container[str] = ()
) -> Scenario:
    """Return the scenario of a recording for a replay of one node, or of all.

    Raises ScenarioError as ``recorded_scenario`` does, and for code that is not allowed; UsageError for a node that the
    run did not have.
    """
    scenario = recorded_scenario(recording, overrides, allow_code)
    named = scenario.user_classes
    if node is not None:
        named = tuple(user for user in named if user.key.startswith(f"{key_of(node)}."))
    check_allowed(named, scenario.user_code, str(recording.path))
    if node is not None and node not in scenario.nodes:
        raise UsageError(f"{recording.path}: has no node {node!r}; its nodes are {', '.join(scenario.nodes)}")
    return scenario


def changed_code(recording: Recording, scenario: Scenario) -> Iterator[ChangedModule]:
    """Yield the modules of the user's that are not those that the recorded run was made with."""
    recorded = _recorded_digests(recording)
    for module, digest in scenario.user_code.items():
        if (then := recorded.get(module)) not in (None, digest):
            yield ChangedModule(module, then, digest)


def _recorded_digests(recording: Recording) -> dict[str, str]:
    """Return the digests of the user's modules with which the recorded run was made, by module."""
    return dict(json.loads(recording.header.scenario).get("user_code", {}))


def replay_nodes(recording: Recording, scenario: Scenario, node: str | None, *, keep: bool) -> list[Replayed]:
    """Return what came of one node, or of each by itself; see ``replay_node``."""
    plan = plan_of(scenario)
    return [replay_node(recording, plan, name, keep=keep) for name in ((node,) if node else plan.graph.nodes)]


def write_nodes(recording: Recording, scenario: Scenario, outcomes: Sequence[Replayed], path: Path) -> None:
    """Write the run with what nodes did now, which was kept, in the place of what they did then."""
    recorded = _recorded_digests(recording)
    # Of code that was not run now, the digest says with which the rest of the recording was made. It is told only: a
    # scenario that held it would have it imported.
    known = {one.module: digest for one in scenario.user_classes if (digest := recorded.get(one.module))}
    told = msgspec.structs.replace(scenario, user_code={**known, **scenario.user_code})
    plan = plan_of(scenario)._replace(text=resolved_json(told))
    attachments = attachments_of(scenario, recording.attachments)
    topics, schemas = plan.graph.topics, recording.schemas
    with RecordingWriter(path, run_header(plan), attachments, topics=topics, schemas=schemas) as writer:
        write_replayed(recording, outcomes, writer)
        whole = recording.end is not None and recording.end.complete
        writer.close(complete=whole, reason=f"replayed from {recording.path.name}")


def run_anew(recording: Recording, scenario: Scenario, path: Path) -> None:
    """Record the whole run anew from its source, with the settings of ``scenario``.

    Raises UsageError for a realtime run, and what the nodes raise.
    """
    if scenario.clock != "lockstep":
        raise UsageError(
            "a realtime run cannot be run anew from its source; choose --node to change one node's settings"
        )
    log = LogContent(log_records(recording), recording.attachments)
    record_inline(scenario, path, log, reason=f"run anew from {recording.path.name}")
