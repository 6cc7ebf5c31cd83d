"""Compares what the end of a run promises with what is in the file."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
from dynpf_protocol.journal import JOURNAL_PREFIX, JournalEntry, decode_entry

from dynpf_formats.recording.account import Account
from dynpf_formats.recording.findings import Finding, by_topic, error, warning
from dynpf_formats.recording.header import Attachment, RunEnd, RunHeader, seal_of
from dynpf_formats.recording.reader import Recording
from dynpf_formats.recording.stream import RecordedSchema, Source

__all__ = ["broken_promises", "end_of", "entry_of"]

_END = "end of run"


Filed = tuple[Source, int, int, int, bytes]
"""Source, sequence number, logical time, publish time and payload of a message or journal entry in a file."""


def end_of(
    header: RunHeader,
    attachments: Sequence[Attachment],
    filed: Iterable[Filed],
    schemas: Mapping[str, RecordedSchema],
    said: RunEnd,
) -> RunEnd:
    """Return the end that a recorder would write of ``filed``, in that order, of a run that ended as ``said``."""
    account = Account(header, attachments)
    opened: set[Source] = set()
    for source, sequence, stamp_ns, publish_ns, payload in filed:
        if source not in opened:
            opened.add(source)
            account.open(source, schemas.get(source.topic, RecordedSchema("", b"")))
        account.add(source, sequence, stamp_ns, publish_ns, payload, entry=entry_of(source.topic, payload))
    return account.end(said.complete, said.reason, said.outcome)


def entry_of(topic: str, payload: bytes) -> JournalEntry | None:
    """Return a journal entry, or None for a message, and for what is no entry."""
    if not topic.startswith(JOURNAL_PREFIX):
        return None
    try:
        return decode_entry(payload)
    except msgspec.DecodeError:
        return None


def broken_promises(recording: Recording) -> Iterator[Finding]:
    """Yield where the file is not what its recorder sealed, or not the complete run that its end speaks of.

    What is not compared is told as such, by a warning.
    """
    end = recording.end
    if end is None:
        return
    found = end_of(recording.header, recording.attachments, recording.rows(), recording.schemas, end)
    if end.complete and not found.complete:
        yield error(found.reason, _END)
    if end.seal != seal_of(end):
        yield error("what the end says is not what its recorder sealed", _END)
    if end.header != found.header:
        yield error("the metadata of the run are not those that the recorder sealed", "metadata run")
    yield from _attachments(end, found)
    yield from _channels(end, found)
    for name in ("gaps", "missing", "duplicates", "late", "unresolved"):
        yield from _difference(f"{name} of the run", getattr(end, name), getattr(found, name))
    for name in sorted({*end.nodes, *found.nodes}):
        yield from _difference(f"the end of the journal of {name}", end.nodes.get(name), found.nodes.get(name))
    if end.order != found.order:
        yield warning(
            "publish times or the order of the messages in the file are not those that the recorder sealed; "
            "neither is compared",
            _END,
        )


def _attachments(end: RunEnd, found: RunEnd) -> Iterator[Finding]:
    if end.attachments == found.attachments:
        return
    sealed, present = set(end.attachments), set(found.attachments)
    for item in (*sorted(sealed - present), *sorted(present - sealed)):
        how = "sealed, but not as it is in the file" if item in sealed else "not as the recorder sealed it"
        yield error(f"attachment {item.name!r} ({item.media_type}) is {how}", "attachments")
    if sealed == present:
        yield error("the attachments are repeated or in another order than the recorder sealed them", "attachments")


def _channels(end: RunEnd, found: RunEnd) -> Iterator[Finding]:
    sealed = {Source(*channel[:3]): channel.digest for channel in end.channels}
    present = {Source(*channel[:3]): channel.digest for channel in found.channels}
    changed = [source for source in {**sealed, **present} if sealed.get(source) != present.get(source)]
    for source in changed:
        sender = f"of {source.node}, boot {source.boot},"
        if source not in present:
            what = f"the messages {sender} are missing"
        elif source not in sealed:
            what = f"messages {sender} which the recorder has not sealed"
        else:
            what = f"the messages {sender} are not those that the recorder sealed"
        yield by_topic(what, source.topic)
    for topic in sorted({*end.counts, *found.counts}):
        promised, counted = end.counts.get(topic, 0), found.counts.get(topic, 0)
        if promised != counted:
            what = f"the recorder counted {promised} messages, in the file are {counted}"
            follows = any(source.topic == topic for source in changed)  # else the end itself is wrong
            yield by_topic(what, topic) if follows else error(what, topic)
    if [*sealed] != [*present] and sealed == present:
        yield error("senders and topics first appear in another order than the recorder sealed", _END)


def _difference(what: str, sealed: Any, found: Any) -> Iterator[Finding]:
    if sealed != found:
        yield error(f"{what}: sealed {_text(sealed)}, in the file {_text(found)}", _END)


def _text(value: Any) -> str:
    return "nothing" if value is None else msgspec.json.encode(value).decode()[:200]
