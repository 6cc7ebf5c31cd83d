"""Finds what is wrong with a recording: bytes, framing, gaps, journals, payloads and senders."""

from collections import Counter
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError, UnknownTopicError
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry
from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE, NODES
from dynpf_protocol.topics import topic as row_of

from dynpf_formats.recording.attachments import changed_files
from dynpf_formats.recording.code import recorded_code
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.reader import Recording, Source, load
from dynpf_formats.shipped import known_topics
from dynpf_formats.user_classes import UserClass

__all__ = ["Diagnosis", "Finding", "Severity", "diagnose", "examine"]


class Severity(StrEnum):
    """How bad a finding is."""

    UNREADABLE = "unreadable"  # the file cannot be read as a recording
    ERROR = "error"  # a part of the run is lost or wrong
    WARNING = "warning"  # something is odd


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong; ``where`` locates it in the file or the run."""

    severity: Severity
    what: str
    where: str


class Diagnosis(NamedTuple):
    """The findings about a file, and the user classes that a replay of it would import and run if allowed."""

    findings: list[Finding]
    code: tuple[UserClass, ...] = ()


def examine(path: Path | str) -> list[Finding]:
    """Return everything that is wrong with a file; an empty list for an intact and complete recording."""
    return diagnose(path).findings


def diagnose(path: Path | str) -> Diagnosis:
    """Return everything that is wrong with a file, and the user classes that it names, without importing them.

    Never raises because of a file's content: a file that is no recording has one finding that says so.
    """
    try:
        recording, damage = load(path)
    except RecordingError as error:
        return Diagnosis([Finding(severity=Severity.UNREADABLE, what=str(error), where=str(path))])
    findings = [
        Finding(severity=Severity.ERROR, what=f"{found.kind}: {found.text}", where=f"byte {found.offset}")
        for found in damage
    ]
    findings += [
        _error(text, "attachments") for text in changed_files(recording.header.scenario, recording.attachments)
    ]
    for check in (_end, _senders, _gaps, _repetitions, _payloads, _journals):
        findings.extend(check(recording))
    return Diagnosis(findings, recorded_code(recording))


def _error(what: str, where: str) -> Finding:
    return Finding(severity=Severity.ERROR, what=what, where=where)


def _warning(what: str, where: str) -> Finding:
    return Finding(severity=Severity.WARNING, what=what, where=where)


def _end(recording: Recording) -> Iterator[Finding]:
    if recording.end is None:
        yield _error("the end of the run was never written: the recorder did not finish", "end of file")
    elif not recording.end.complete:
        yield _error(f"the run is not complete: {recording.end.reason}", "end of run")


def _senders(recording: Recording) -> Iterator[Finding]:
    publishers = _publishers(recording)
    nodes = recording.header.writes or NODES
    for source in recording.sources:
        if source.topic.startswith(JOURNAL_PREFIX):
            if source.node not in nodes or source.topic != JOURNAL_PREFIX + source.node:
                yield _error(f"a journal of unknown node {source.node!r}", source.topic)
        elif not (expected := publishers.get(source.topic) or _log_publishers(source.topic)):
            yield _error(f"this run has no topic {source.topic!r}", source.topic)
        elif source.node not in expected:
            yield _error(f"sent by {source.node!r}; expected {', '.join(expected)}", source.topic)


def _publishers(recording: Recording) -> dict[str, tuple[str, ...]]:
    """Return the allowed senders of each topic: nodes by the header, and hosts, recorder and log."""
    found = {row.name: row.publishers for row in known_topics().values()}
    if not recording.header.writes:
        return found
    found = {}
    nodes = tuple(recording.header.writes)
    for node, topics in recording.header.writes.items():
        for name in (EVENT_PREFIX + node, *topics):
            found[name] = (*found.get(name, ()), node)
    return {**found, "log": (*nodes, "recorder"), "diagnostics": nodes, "recorder/gap": ("recorder",)}


def _log_publishers(name: str) -> tuple[str, ...]:
    try:
        publishers = row_of(name).publishers
    except UnknownTopicError:
        return ()
    return publishers if publishers == (LOG_NODE,) else ()


def _gaps(recording: Recording) -> Iterator[Finding]:
    for source in recording.sources:
        if source.topic.startswith(JOURNAL_PREFIX):
            continue  # _journals checks its steps
        expected = 0
        for record in recording.of(source):
            if record.sequence > expected:
                missing = _range(expected, record.sequence - 1)
                yield _error(f"missing: sequence {missing} of {source.node}, boot {source.boot}", source.topic)
            expected = record.sequence + 1


def _repetitions(recording: Recording) -> Iterator[Finding]:
    same: Counter[Source] = Counter()
    other: Counter[Source] = Counter()
    for first, record in recording.repetitions():
        equal = first.stamp_ns == record.stamp_ns and first.payload == record.payload
        (same if equal else other)[record.source] += 1
    for source, count in same.items():
        yield _warning(f"{count} messages of {source.node} were recorded twice", source.topic)
    for source, count in other.items():
        yield _error(f"{count} sequence numbers of {source.node} stand for two different messages", source.topic)


def _payloads(recording: Recording) -> Iterator[Finding]:
    counts: Counter[tuple[str, str]] = Counter()
    firsts: dict[tuple[str, str], str] = {}
    for record in recording.messages():
        if record.topic not in recording.topics:
            continue
        try:
            decode(record.topic, record.payload, recording.topics)
        except BadMessageError as error:
            counts[record.topic, record.node] += 1
            firsts.setdefault((record.topic, record.node), f"sequence {record.sequence}: {error}")
        except RecordingError as error:
            yield _error(str(error), record.topic)
            return
    for (topic, node), count in counts.items():
        yield _error(f"{count} unreadable messages of {node}, first {firsts[topic, node]}", topic)


def _journals(recording: Recording) -> Iterator[Finding]:
    for node, boot in recording.journals():
        name = JOURNAL_PREFIX + node
        expected = 0
        unresolved, first = 0, ""
        for record in recording.of(Source(name, node, boot)):
            try:
                entry = decode_entry(record.payload)
            except msgspec.DecodeError as error:
                yield _error(f"entry {record.sequence} is unreadable: {error}", name)
                continue
            if entry.step != expected:
                missing = _range(expected, entry.step - 1) if entry.step > expected else f"{entry.step} again"
                yield _error(f"missing: step {missing}, boot {boot}", name)
            expected = entry.step + 1
            for reference in _unresolved(recording, node, boot, entry):
                unresolved += 1
                first = first or reference
        if unresolved:
            yield _error(f"{unresolved} references to messages that are not recorded, first {first}", name)


def _unresolved(recording: Recording, node: str, boot: str, entry: JournalEntry) -> Iterator[str]:
    references = [("consumed", read.node, read.boot, read.topic, read.sequence) for read in entry.consumed]
    references += [("produced", node, boot, made.topic, made.sequence) for made in entry.produced]
    for how, sender, start, topic, sequence in references:
        if recording.find(sender, start, topic, sequence) is None:
            yield f"{topic} {sequence} of {sender}, {how} in step {entry.step}"


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"
