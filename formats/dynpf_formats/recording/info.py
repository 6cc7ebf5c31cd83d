"""The summary of a recording, for scripts and for people."""

from contextlib import suppress
from typing import Any

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.control import Outcome
from dynpf_protocol.errors import ProtocolError
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.json_text import read_json
from dynpf_protocol.messages import Restart
from dynpf_protocol.printable import printable

from dynpf_formats.recording.code import code_in_words, described_code, recorded_code
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.provenance import collect, provenance_difference
from dynpf_formats.recording.reader import Recording

__all__ = ["describe", "ended", "in_words", "text", "title_of"]


def describe(recording: Recording) -> dict[str, Any]:
    """Return the summary that ``dynpf info --json`` prints."""
    end = recording.end
    topics: dict[str, dict[str, int]] = {}
    first_stamp, last_stamp = None, 0
    for record in recording.messages():
        row = topics.setdefault(record.topic, {"messages": 0, "bytes": 0})
        row["messages"] += 1
        row["bytes"] += record.size
        first_stamp = record.stamp_ns if first_stamp is None else min(first_stamp, record.stamp_ns)
        last_stamp = max(last_stamp, record.stamp_ns)
    provenance = recording.header.provenance
    return {
        "file": str(recording.path),
        "file_bytes": recording.path.stat().st_size,
        "title": title_of(recording),
        "seed": recording.header.seed,
        "complete": end is not None and end.complete,
        "reason": end.reason if end is not None else "the end of the run was never written",
        "outcome": end.outcome if end is not None else "",
        "truncated": recording.truncated,
        "duration_s": (last_stamp - (first_stamp or 0)) / 1e9,
        "ticks": _ticks(recording),
        "messages": sum(row["messages"] for row in topics.values()),
        "gaps": _missing(recording),
        "restarts": [msgspec.to_builtins(one) for one in restarts(recording)],
        "content_digest": content_digest(recording),
        "topics": dict(sorted(topics.items())),
        "nodes": {node: len(recording.boots(node)) for node in sorted({source.node for source in recording.sources})},
        "attachments": {item.name: len(item.data) for item in recording.attachments},
        "code": described_code(recorded_code(recording)),
        "schema_version": recording.header.schema_version,
        "dynpf_version": provenance.dynpf_version,
        "code_digest": provenance.code_digest,
        "packages": provenance.packages,
        "platform": provenance.platform,
        "platform_differs": provenance_difference(provenance, collect()),
    }


def restarts(recording: Recording) -> list[Restart]:
    """Return which processes were started again in mid-run; what cannot be read is left out."""
    found = []
    for record in recording.messages("recorder/restart"):
        with suppress(ProtocolError):
            restart = decode(record.topic, record.payload)
            if isinstance(restart, Restart):
                found.append(restart)
    return found


def in_words(restart: Restart) -> str:
    """Return what a restart was and what it has cost, as a sentence."""
    node = printable(restart.node)
    return f"{node} was gone after tick {restart.tick}, and started again: {restart.absent_s:.1f} s"


def ended(reason: str, outcome: str) -> str:
    """Return why a run has ended: by its recorder, and whether its task was done or its budget spent."""
    return reason if outcome in ("", Outcome.STOPPED) else f"{reason}, {outcome}"


def text(summary: dict[str, Any]) -> str:
    """Return a summary as lines for a person."""
    state = f"complete: {ended(summary['reason'], summary['outcome'])}"
    if not summary["complete"]:
        state = f"INCOMPLETE: {summary['reason']}"
    lines = [
        f"{summary['file']}: {summary['title']}, seed {summary['seed']}",
        f"  {state}",
        f"  {summary['duration_s']:.3f} s, {summary['ticks']} ticks, {summary['messages']} messages, "
        f"{summary['gaps']} missing, {summary['file_bytes']} bytes",
        f"  content {summary['content_digest']}",
        *(f"  {in_words(msgspec.convert(one, Restart))}" for one in summary["restarts"]),
        f"  dynpf {summary['dynpf_version']}, code {summary['code_digest'][:12]}, "
        f"schema version {summary['schema_version']}",
        f"  {', '.join(f'{name} {version}' for name, version in summary['packages'].items())}",
        *(f"  {name}: {value}" for name, value in summary["platform"].items()),
        *(f"  {line}" for line in (summary["platform_differs"],) if line),
        *(f"  attachment {name}: {size} bytes" for name, size in summary["attachments"].items()),
        *(f"  {line}" for line in code_in_words(summary["code"])),
    ]
    width = max((len(topic) for topic in summary["topics"]), default=0)
    lines += [
        f"  {topic:{width}}  {row['messages']:>8} messages  {row['bytes']:>11} bytes"
        for topic, row in summary["topics"].items()
    ]
    return "\n".join(lines)


def title_of(recording: Recording) -> str:
    """Return the title of a recorded run, of an imported log its source."""
    try:
        scenario = read_json(recording.header.scenario, dict[str, Any])
    except msgspec.DecodeError:
        return "untitled"
    imported = scenario.get("import")  # an importer describes its source instead of a scenario
    if isinstance(imported, dict) and "source" in imported:
        return f"log imported from {imported['source']}"
    return str(scenario.get("title", "untitled"))


def _ticks(recording: Recording) -> int:
    """Return the number of ticks in the journals."""
    last = -1
    for node, boot in recording.journals():
        for entry in recording.journal(node, boot):
            last = max(last, entry.tick)
    return last + 1


def _missing(recording: Recording) -> int:
    missing = 0
    for source in recording.sources:
        if not source.topic.startswith(JOURNAL_PREFIX):
            records = recording.of(source)
            missing += records[-1].sequence + 1 - len(records)
    return missing
