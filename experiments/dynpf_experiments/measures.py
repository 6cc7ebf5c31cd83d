"""Measures of a run against its truth, under stable names.

Each system lists and documents its own (``MEASURES``). Every recording also has the number of its ``messages`` that are
compared, the number of missing ones as ``gaps``, whether it is ``complete``, and its ``content_digest``.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.info import ended, in_words, restarts
from dynpf_formats.recording.reader import Recording
from dynpf_formats.shipped import listed, load
from dynpf_protocol.json_text import read_json
from dynpf_protocol.messages import Message
from dynpf_protocol.topics import is_compared
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import override_resolved
from dynpf_services.scenario.schema import Scenario

from dynpf_experiments.messages import RunMessages, recorded

__all__ = [
    "Measures",
    "described",
    "differing",
    "estimates_of",
    "lines_of",
    "measure",
    "measure_run",
    "measured_topics",
    "summary",
    "truth_of",
]


class Measures(NamedTuple):
    """The measures of a system.

    ``of_run`` returns the measures of a run by name, without those for which it has no data; ``lines`` returns them as
    text for a person. ``estimate`` is the type of the system's estimates, ``reads`` are the types of messages that the
    measures need, and ``truths`` are the topics of the truth, of which a run has one. ``aligned`` returns the run with
    its truth moved as close to the estimates as a change of frames can bring it. ``of_recording`` returns the measures
    of a recorded run, those among them for which a recording's readings and files are needed, too.
    """

    estimate: type[Message]
    reads: tuple[type[Message], ...]
    truths: tuple[str, ...]
    of_run: Callable[[RunMessages], dict[str, Any]]
    lines: Callable[[Mapping[str, Any]], list[str]]
    aligned: Callable[[RunMessages], RunMessages] | None = None
    of_recording: Callable[[RunMessages], dict[str, Any]] | None = None


@cache
def _all_measures() -> tuple[Measures, ...]:
    return tuple(map(load, listed("MEASURES")))


def measure(recording: Recording, *, truth_align: bool = False) -> dict[str, Any]:
    """Return the measures of a recording; measures without data are left out.

    With ``truth_align``, the truth of logs is first moved as close to the estimates as a change of frames can bring it.
    """
    outcome = recording.end.outcome if recording.end is not None else ""
    return {
        **_figures(recording, truth_align=truth_align),
        "outcome": outcome,
        "content_digest": content_digest(recording),
    }


def measure_run(run: RunMessages) -> dict[str, Any]:
    """Return the measures of a run that need its messages only."""
    return {name: value for measures in _all_measures() for name, value in measures.of_run(run).items()}


def measured_topics(scenario: Scenario) -> list[str]:
    """Return the topics of a run of ``scenario`` that measures need."""
    read = {kind for measures in _all_measures() for kind in measures.reads}
    return [name for name, row in plan_of(scenario).graph.topics.items() if row.type in read]


def estimates_of(run: RunMessages) -> list[str]:
    """Return the topics of a run with estimates, in the order of its nodes."""
    kinds = dict.fromkeys(measures.estimate for measures in _all_measures())
    return [topic for kind in kinds for topic in run.carrying(kind)]


def truth_of(run: RunMessages) -> str | None:
    """Return the topic of a run's truth, or None without a truth."""
    return next((topic for measures in _all_measures() for topic in measures.truths if topic in run.topics), None)


def differing(a: Recording, b: Recording) -> dict[str, tuple[Any, Any]]:
    """Return the measures, except the digest, in which two runs differ: both values, None where a run lacks one."""
    left, right = _figures(a), _figures(b)
    names = [*left, *(name for name in right if name not in left)]
    return {name: (left.get(name), right.get(name)) for name in names if left.get(name) != right.get(name)}


def _figures(recording: Recording, *, truth_align: bool = False) -> dict[str, Any]:
    end = recording.end
    return {
        **_measured(recorded(recording), truth_align=truth_align),
        "messages": sum(is_compared(record.topic) for record in recording.messages()),
        "gaps": end.missing if end is not None else None,
        "complete": end is not None and end.complete and not recording.truncated,
    }


def _measured(run: RunMessages, *, truth_align: bool) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for measures in _all_measures():
        aligned = measures.aligned(run) if truth_align and measures.aligned is not None else run
        found |= (measures.of_recording or measures.of_run)(aligned)
    return {**found, "truth_aligned": True} if truth_align else found


def described(recording: Recording) -> dict[str, Any]:
    """Return what a run was, for scripts: the file, scenario, seed, clock, duration, and its nodes.

    ``kinds`` has the kind of each node, ``settings`` its table of the scenario with every default, ``estimates`` the
    number of messages by the topic of each estimator.
    """
    scenario = override_resolved(recording.header.scenario, (), str(recording.path))
    raw = read_json(recording.header.scenario, dict[str, Any])
    listed_nodes = raw.get("nodes") or []
    tables = {**raw, **{str(table.get("name")): table for table in listed_nodes if isinstance(table, dict)}}
    settings = {name: tables[name] for name in scenario.nodes if isinstance(tables.get(name), dict)}
    stamps = [record.stamp_ns for record in recording.messages()]
    end = recording.end
    return {
        "recording": str(recording.path),
        "scenario": scenario.title,
        "seed": recording.header.seed,
        "clock": recording.header.clock,
        "reason": end.reason if end is not None else "its end was never written",
        "duration_s": (max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0,
        "estimates": {topic: sum(1 for _ in recording.messages(topic)) for topic in estimates_of(recorded(recording))},
        "kinds": {name: table.get("kind", "") for name, table in settings.items()},
        "settings": {name: {k: v for k, v in table.items() if k != "kind"} for name, table in settings.items()},
    }


def lines_of(measures: Mapping[str, Any]) -> list[str]:
    """Return the measures of the systems as text for a person."""
    return [line for system in _all_measures() for line in system.lines(measures)]


def summary(recording: Recording, measures: Mapping[str, Any]) -> str:
    """Return the measures as text for a person."""
    scenario = override_resolved(recording.header.scenario, (), str(recording.path))
    state = "complete" if measures["complete"] else "INCOMPLETE"
    end = recording.end
    reason = ended(end.reason, end.outcome) if end is not None else "it was never closed"
    lines = [f"{scenario.title} (seed {scenario.seed})", f"recording   {recording.path}, {state}: {reason}"]
    for topic in estimates_of(recorded(recording))[:1]:
        stamps = [record.stamp_ns for record in recording.messages(topic)]
        if not stamps:
            continue  # a damaged file: it describes the topic, and its messages are lost
        lines.append(f"duration    {(max(stamps) - min(stamps)) * 1e-9:.1f} s of logical time, {len(stamps)} estimates")
    lines.append(f"messages    {measures['messages']}, {measures['gaps']} missing")
    lines += [f"{'restarts' if not index else '':<12}{in_words(one)}" for index, one in enumerate(restarts(recording))]
    lines += lines_of(measures)
    lines.append(f"digest      {measures['content_digest']}")
    return "\n".join(lines)
