"""Asks what made two recorded runs differ, and says what is known of it."""

import json
from collections.abc import Container, Iterator
from typing import NamedTuple

from dynpf_formats.recording.diff import FirstDifference, diff
from dynpf_formats.recording.provenance import provenance_difference
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import DynpfError, UsageError
from dynpf_protocol.topics import LOG_NODE
from dynpf_runtime.replay import replay_node
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.replay import scenario_of_replay

from dynpf_experiments.bisect.origin import Origin, origin
from dynpf_experiments.bisect.search import Found, search
from dynpf_experiments.bisect.settings import changes, settings_of

__all__ = ["Answer", "compare"]


class Answer(NamedTuple):
    """What was found: the first difference, what the runs were made of that differs besides settings, the search.

    ``found`` is None if no settings differ, or if the runs cannot be executed again; ``unsearched`` then says why.
    ``origin`` and ``notes`` tell of the step that made the first difference, where settings do not explain it.
    """

    cause: bool
    first: FirstDifference | None
    made_of: tuple[str, ...] = ()
    found: Found | None = None
    unsearched: str = ""
    origin: Origin | None = None
    notes: tuple[str, ...] = ()


def compare(a: Recording, b: Recording, allow_code: Container[str] = ()) -> Answer:
    """Find what made two runs differ.

    Raises ScenarioError if a lockstep run whose settings differ cannot be executed here, and for user code that is not
    allowed; UsageError for a recording that is none of a run.
    """
    for recording in (a, b):
        if not recording.journals():
            raise UsageError(f"{recording.path}: is not of a run of nodes, but an imported log, or empty")
    first = diff(a, b).first
    if first is None:
        return Answer(cause=False, first=None)
    made_of, found, unsearched = tuple(_made_of(a, b)), None, ""
    differing = changes(*(settings_of(run.header.scenario, str(run.path)) for run in (a, b)))
    if differing and "realtime" in (a.header.clock, b.header.clock):
        named = ", ".join(change.key for change in differing)
        unsearched = f"settings that differ: {named}; a realtime run cannot be executed again from its source"
    elif differing:
        found = search(a, b, allow_code)
        if found.causes and found.rest is None:
            return Answer(cause=True, first=first, made_of=made_of, found=found)
    whence = origin(a, b, first)
    notes = tuple(_reproduced(a, b, first, allow_code)) if whence.kind == "node" else ()
    arrived = whence.kind == "inputs" and a.header.clock == b.header.clock == "realtime" and not differing
    if arrived:
        notes = ("in realtime that depends on when messages arrived, which no two runs have in common",)
    known = bool(found and found.causes) or (not unsearched and (whence.kind != "inputs" or arrived))
    return Answer(known, first, made_of, found, unsearched, whence, notes)


def _made_of(a: Recording, b: Recording) -> Iterator[str]:
    """Yield what the runs were made of that differs, without their settings."""
    one, other = a.header.provenance, b.header.provenance
    if one.dynpf_version != other.dynpf_version:
        yield f"dynpf's version, {one.dynpf_version} and {other.dynpf_version}"
    if one.code_digest != other.code_digest:
        yield f"dynpf's code, {one.code_digest[:12]} and {other.code_digest[:12]}"
    if apart := provenance_difference(one, other, "and"):
        yield f"the installation, {apart.removeprefix('recorded with ')}"
    left, right = (_modules(run) for run in (a, b))
    for module in sorted({**left, **right}):
        if left.get(module) != right.get(module):
            yield f"the module {module}, {left.get(module, 'none')[:12]} and {right.get(module, 'none')[:12]}"
    contents = [{item.name: item.data for item in run.attachments} for run in (a, b)]
    for name in sorted({**contents[0], **contents[1]}):
        if contents[0].get(name) != contents[1].get(name):
            yield f"the attachment {name}"


def _modules(recording: Recording) -> dict[str, str]:
    found: dict[str, str] = json.loads(recording.header.scenario).get("user_code") or {}
    return found


def _reproduced(a: Recording, b: Recording, first: FirstDifference, allow_code: Container[str]) -> Iterator[str]:
    """Yield what the node is that made something else of the same inputs, and whose output this installation makes."""
    if first.node == LOG_NODE:
        return
    for name, recording in (("A", a), ("B", b)):
        try:
            plan = plan_of(scenario_of_replay(recording, first.node, allow_code=allow_code))
            mismatch = replay_node(recording, plan, first.node).mismatch
        except DynpfError as error:
            yield f"{first.node} of {name} cannot be executed again here: {error}"
            continue
        kind = plan.graph.specs[first.node].kind
        verdict = "as recorded" if mismatch is None else f"otherwise from tick {mismatch.tick} on"
        yield f"{first.node} of {name} is {kind}; this installation makes it {verdict}"
