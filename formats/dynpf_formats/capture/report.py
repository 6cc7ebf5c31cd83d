"""What a capture holds and lacks, for people and for scripts: its summary, and what is wrong with it."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dynpf_protocol.printable import printable

from dynpf_formats.capture.form import Began, Ended
from dynpf_formats.capture.reader import Capture
from dynpf_formats.capture.series import Series
from dynpf_formats.capture.tally import Sender, Tally, Topic
from dynpf_formats.recording.findings import Finding, error, warning
from dynpf_formats.ros2.attachment import Lost

__all__ = ["describe", "examine", "summary_lines", "unnumbered"]

_SHOWN_RANGES = 10
_SHOWN_DIGITS = 8  # of a publisher's name, in lines for people


def examine(capture: Capture) -> list[Finding]:
    """Return what is wrong with a capture; an empty list if nothing is missing of what had numbers."""
    tally = capture.tally
    findings = [
        error(f"{found.kind}: {found.text}", f"byte {found.offset}" if found.offset else "metadata")
        for found in capture.damage
    ]
    findings += _of_the_end(capture)
    for sender in tally.senders:
        findings += _of_a_sender(sender)
    for key, count in sorted(tally.dropped_unnumbered.items()):
        findings.append(error(f"{count} messages without numbers had no room in the recorder", tally.topic_of(key)))
    for name, topic in sorted(tally.topics.items()):
        findings += [
            warning(f"{count} messages are {fault}; kept as they came", name) for fault, count in topic.faults.items()
        ]
    for since_ns, until_ns in tally.outages:
        end = f"for {(until_ns - since_ns) / 1e9:.1f} s" if until_ns else "to the end"
        findings.append(
            warning(f"no router {end}; messages without numbers that were published then are unknown", _time(since_ns))
        )
    return findings


def _of_the_end(capture: Capture) -> Iterator[Finding]:
    ended, tally = capture.ended, capture.tally
    if ended is None:
        yield error("the end was never written: the recorder did not finish", "end of file")
        return
    if not ended.complete:
        yield error(f"not complete: {ended.reason}", "end")
    for name in ("messages", "missing", "dropped"):
        counted, found = getattr(ended, name), getattr(tally, name)
        if counted != found:
            what = "messages" if name == "messages" else f"{name} messages"
            yield error(f"its recorder counted {counted} {what}, from the file follow {found}", "end")


def _of_a_sender(sender: Sender) -> Iterator[Finding]:
    series, of = sender.series, f"of publisher {sender.publisher[:_SHOWN_DIGITS]}"
    if series.missing:
        yield error(f"{series.missing} messages {of} never came: {_ranges(series.lost)}", sender.topic)
    if series.dropped:
        yield error(f"{series.dropped} messages {of} came, and the recorder had no room for them", sender.topic)
    if series.duplicates:
        yield warning(f"{series.duplicates} messages {of} came again", sender.topic)
    if series.late:
        yield warning(f"{series.late} messages {of} came after a later one", sender.topic)


def _ranges(lost: Sequence[Lost]) -> str:
    texts = [str(first) if first == last else f"{first} to {last}" for first, last in lost[:_SHOWN_RANGES]]
    more = len(lost) - len(texts)
    return f"numbers {', '.join(texts)}" + (f", and {more} ranges more" if more else "")


def unnumbered(tally: Tally) -> list[str]:
    """Return the topics of which a loss would not be seen: not all of their messages have numbers."""
    return sorted(name for name, topic in tally.topics.items() if topic.unnumbered)


def describe(capture: Capture) -> dict[str, Any]:
    """Return the summary that ``dynpf info --json`` prints."""
    return {
        **summary(capture.path, capture.began, capture.ended, capture.tally),
        "truncated": capture.truncated,
        "damaged": len(capture.damage),
    }


def summary(path: Path, began: Began, ended: Ended | None, tally: Tally) -> dict[str, Any]:
    """Return what was heard and what was not, as ``dynpf record --json`` prints it."""
    return {
        "file": str(path),
        "file_bytes": path.stat().st_size,
        "connect": began.connect,
        "keys": list(began.keys),
        "domain": began.domain,
        "format": began.format,
        "began": _time(began.began_ns),
        "complete": ended is not None and ended.complete,
        "reason": ended.reason if ended is not None else "the end was never written",
        "duration_s": _span_s(tally),
        "messages": tally.messages,
        "missing": tally.missing,
        "dropped": tally.dropped,
        "outages": [
            {"since": _time(since), "until": _time(until) if until else None} for since, until in tally.outages
        ],
        "topics": _topics(tally),
        "publishers": [_sender(sender) for sender in tally.senders],
        "dynpf_version": began.dynpf_version,
    }


def _topics(tally: Tally) -> dict[str, Any]:
    series: defaultdict[str, list[Series]] = defaultdict(list)
    for sender in tally.senders:
        series[sender.topic].append(sender.series)
    return {name: _topic(topic, series[name]) for name, topic in sorted(tally.topics.items())}


def _topic(topic: Topic, series: Sequence[Series]) -> dict[str, Any]:
    return {
        "type": topic.type,
        "messages": topic.messages,
        "bytes": topic.bytes,
        "rate_hz": topic.rate_hz,
        "publishers": len(series),
        "missing": sum(one.missing for one in series),
        "dropped": sum(one.dropped for one in series),
        "without_numbers": topic.unnumbered,
        "invalid": topic.faults.total(),
    }


def _sender(sender: Sender) -> dict[str, Any]:
    series = sender.series
    counts = ("received", "missing", "dropped", "duplicates", "late", "restarts")
    return {
        "topic": sender.topic,
        "key": sender.key,
        "publisher": sender.publisher,
        **{name: getattr(series, name) for name in counts},
        "lost": [list(lost) for lost in series.lost],
    }


def _span_s(tally: Tally) -> float:
    topics = tally.topics.values()
    if not topics:
        return 0.0
    return (max(topic.last_ns for topic in topics) - min(topic.first_ns for topic in topics)) / 1e9


def summary_lines(told: dict[str, Any]) -> list[str]:
    """Return a summary as lines for a person, without control characters."""
    state = f"complete: {told['reason']}" if told["complete"] else f"INCOMPLETE: {told['reason']}"
    keys = ", ".join(told["keys"])
    lines = [
        f"{told['file']}: heard at {told['connect']}, keys {keys}, ROS domain {told['domain']}, from {told['began']}",
        f"  {state}",
        f"  {told['duration_s']:.3f} s, {len(told['topics'])} topics, {told['messages']} messages, "
        f"{told['missing']} never came, {told['dropped']} had no room here, {told['file_bytes']} bytes",
        *(f"  no router from {out['since']} to {out['until'] or 'the end'}" for out in told["outages"]),
    ]
    width = max((len(name) for name in told["topics"]), default=0)
    kinds = max((len(row["type"]) for row in told["topics"].values()), default=0)
    lines += [f"  {name:{width}}  {row['type']:{kinds}}  {_counts(row)}" for name, row in told["topics"].items()]
    return [printable(line, 2000) for line in lines]


def _counts(row: dict[str, Any]) -> str:
    text = f"{row['messages']:>8} messages  {row['rate_hz']:>8.2f} Hz  {row['bytes']:>11} bytes"
    told = [
        f"{row[name]} {what}"
        for name, what in (("missing", "never came"), ("dropped", "had no room here"))
        if row[name]
    ]
    if row["without_numbers"]:
        told.append("no numbers: losses are not seen")
    if row["invalid"]:
        told.append("no ROS messages")
    return f"{text}  {', '.join(told)}".rstrip()


def _time(at_ns: int) -> str:
    return datetime.fromtimestamp(at_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
