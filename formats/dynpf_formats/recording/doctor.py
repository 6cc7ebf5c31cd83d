"""Finds what is wrong with a recording: bytes, framing, gaps, payloads, senders, journals, and its end's promises."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.messages import Restart
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import EVENT_PREFIX, LOG_NODE, NODES, is_act, is_record

from dynpf_formats.recording.attachments import changed_files, foreign_attachments
from dynpf_formats.recording.code import recorded_code
from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.findings import Finding, Severity, by_topic, error
from dynpf_formats.recording.info import restarts
from dynpf_formats.recording.journals import check_journals
from dynpf_formats.recording.mcap_records import Damage
from dynpf_formats.recording.reader import Recording, Source, load
from dynpf_formats.recording.sealed import broken_promises
from dynpf_formats.recording.snapshots import check_snapshots
from dynpf_formats.shipped import known_topics
from dynpf_formats.user_classes import UserClass

__all__ = ["Diagnosis", "Finding", "Severity", "altered", "diagnose", "diagnosis", "examine"]


class _File(msgspec.Struct):
    sha256: str


class _Files(msgspec.Struct):
    """What a scenario says of its files."""

    files: dict[str, _File] = {}


class Diagnosis(NamedTuple):
    """The findings about a file, and what it says besides.

    That are the user classes that a replay of it would import and run if allowed, those of the findings that
    ``altered`` returns, the processes that were started again, and whether its run may be resumed: it is one in
    lockstep, and not whole.
    """

    findings: list[Finding]
    code: tuple[UserClass, ...] = ()
    altered: tuple[Finding, ...] = ()
    restarts: tuple[Restart, ...] = ()
    resumable: bool = False


def examine(path: Path | str) -> list[Finding]:
    """Return everything that is wrong with a file; an empty list for an intact and complete recording."""
    return diagnose(path).findings


def diagnose(path: Path | str) -> Diagnosis:
    """Return everything that is wrong with a file, and the user classes that it names, without importing them.

    Never raises because of a file's content: a file that is no recording has one finding that says so.
    """
    try:
        recording, damage = load(path)
    except RecordingError as bad:
        what = str(bad).removeprefix(f"{path}: ")
        return Diagnosis([Finding(severity=Severity.UNREADABLE, what=what, where=str(path))])
    return diagnosis(recording, damage)


def diagnosis(recording: Recording, damage: Iterable[Damage]) -> Diagnosis:
    """Return everything that is wrong with a recording that was read, and with the file that it was read from."""
    findings = [
        Finding(severity=Severity.ERROR, what=f"{found.kind}: {found.text}", where=f"byte {found.offset}")
        for found in damage
    ]
    of_content: list[Finding] = []
    checks = (_end, _senders, _gaps, _repetitions, _payloads, _files, check_journals, broken_promises, check_snapshots)
    for check in checks:
        found_now = [*check(recording)]
        findings += found_now
        of_content += _errors(found_now) if check in _OF_CONTENT else ()
    unfinished = recording.end is None or not recording.end.complete
    resumable = unfinished and recording.header.clock == "lockstep"
    return Diagnosis(findings, recorded_code(recording), tuple(of_content), tuple(restarts(recording)), resumable)


def altered(recording: Recording) -> list[Finding]:
    """Return why a recording is not what its recorder wrote, or not the run that its end speaks of.

    A run that broke off, and says so, is not altered by that.
    """
    return [found for check in _OF_CONTENT for found in _errors(check(recording))]


def _errors(findings: Iterable[Finding]) -> Iterator[Finding]:
    return (found for found in findings if found.severity is Severity.ERROR)


def _end(recording: Recording) -> Iterator[Finding]:
    if recording.end is None:
        yield error("the end of the run was never written: the recorder did not finish", "end of file")
    elif not recording.end.complete:
        yield error(f"the run is not complete: {recording.end.reason}", "end of run")


def _senders(recording: Recording) -> Iterator[Finding]:
    publishers = _publishers(recording)
    nodes = recording.header.writes or NODES
    for source in recording.sources:
        if source.topic.startswith(JOURNAL_PREFIX):
            if source.node not in nodes or source.topic != JOURNAL_PREFIX + source.node:
                yield error(f"a journal of unknown node {source.node!r}", source.topic)
        elif not (expected := publishers.get(source.topic) or _fed(source.topic, tuple(nodes))):
            yield error(f"this run has no topic {source.topic!r}", source.topic)
        elif source.node not in expected:
            yield error(f"sent by {source.node!r}; expected {', '.join(expected)}", source.topic)


def _fed(topic: str, nodes: tuple[str, ...]) -> tuple[str, ...]:
    """Return who publishes what comes from outside: the log its records, the run's source a person's acts."""
    return (LOG_NODE,) if is_record(topic) else nodes[:1] if is_act(topic) else ()


def _publishers(recording: Recording) -> dict[str, tuple[str, ...]]:
    """Return the allowed senders of each topic: nodes by the header, and hosts, recorder and log."""
    found = {row.name: row.publishers for row in known_topics().values()}
    if not recording.header.writes:
        return found
    found = {}
    nodes = tuple(recording.header.writes)
    for node, topics in recording.header.writes.items():
        for name in (EVENT_PREFIX + node, SNAPSHOT_PREFIX + node, *topics):
            found[name] = (*found.get(name, ()), node)
    own = dict.fromkeys(("recorder/gap", "recorder/restart"), ("recorder",))
    return {**found, "log": (*nodes, "recorder"), "notice": nodes, "diagnostics": nodes, **own}


def _gaps(recording: Recording) -> Iterator[Finding]:
    for source in recording.sources:
        if source.topic.startswith(JOURNAL_PREFIX):
            continue  # _journals checks its steps
        expected = 0
        for record in recording.of(source):
            if record.sequence > expected:
                missing = _range(expected, record.sequence - 1)
                yield by_topic(f"missing: sequence {missing} of {source.node}, boot {source.boot}", source.topic)
            expected = record.sequence + 1


def _repetitions(recording: Recording) -> Iterator[Finding]:
    """Yield the numbers that came twice: a recorder writes each once, whatever it is sent."""
    same: Counter[Source] = Counter()
    other: Counter[Source] = Counter()
    for first, record in recording.repetitions():
        equal = first.stamp_ns == record.stamp_ns and first.payload == record.payload
        (same if equal else other)[record.source] += 1
    for source, count in same.items():
        yield error(f"{count} messages of {source.node} were recorded twice", source.topic)
    for source, count in other.items():
        yield error(f"{count} sequence numbers of {source.node} stand for two different messages", source.topic)


def _files(recording: Recording) -> Iterator[Finding]:
    """Yield the files that the scenario names and that are not attached as it says."""
    for name, count in Counter(item.name for item in recording.attachments).items():
        if count > 1:
            yield error(f"{name!r} is attached {count} times", "attachments")
    if recording.header.writes:
        for name in foreign_attachments(recording.header.scenario, recording.attachments):
            yield error(f"{name!r:.80} is attached, which the scenario does not name", "attachments")
    for text in changed_files(recording.header.scenario, recording.attachments):
        yield error(text, "attachments")


def _payloads(recording: Recording) -> Iterator[Finding]:
    counts: Counter[tuple[str, str]] = Counter()
    firsts: dict[tuple[str, str], str] = {}
    for record in recording.messages():
        if record.topic not in recording.topics:
            continue
        try:
            decode(record.topic, record.payload, recording.topics)
        except BadMessageError as bad:
            counts[record.topic, record.node] += 1
            firsts.setdefault((record.topic, record.node), f"sequence {record.sequence}: {bad}")
        except RecordingError as bad:
            yield error(str(bad), record.topic)
            return
    for (topic, node), count in counts.items():
        yield error(f"{count} unreadable messages of {node}, first {firsts[topic, node]}", topic)


def _range(first: int, last: int) -> str:
    return str(first) if first == last else f"{first} to {last}"


_OF_CONTENT = (_senders, _repetitions, _files, check_journals, broken_promises)
"""The checks of what a recording says, apart from how much of it is there."""
