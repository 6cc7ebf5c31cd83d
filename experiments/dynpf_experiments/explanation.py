"""Why a run went as it did, in words: each verdict of its filters, what changed, and what happened at the time."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from dynpf_formats.recording.info import ended, title_of
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.printable import printable

from dynpf_experiments.pictures.drawing import Track
from dynpf_experiments.pictures.estimates import Span, estimates_of, position_errors, shares, verdicts
from dynpf_experiments.pictures.event import Event
from dynpf_experiments.pictures.events import events_of
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_experiments.pictures.tracks import tracks_of

__all__ = ["Explanation", "Verdict", "as_data", "explanation", "in_words"]

_OWN_WORDS = "the estimate is "


class Verdict(NamedTuple):
    """What a node said of its estimate from ``begin`` until ``end``, s, why, and what changed then.

    ``error_m`` is the median distance between estimate and truth in that time; None where nothing is known of it.
    """

    node: str
    begin: float
    end: float
    status: str
    reason: str
    changed: str
    error_m: float | None


class Explanation(NamedTuple):
    """The story of a run. ``shares`` are those of its time in each status, by node; times are s since its start."""

    title: str
    seed: int
    complete: bool
    ended: str
    seconds: float
    shares: dict[str, dict[str, float]]
    verdicts: list[Verdict]
    events: list[Event]
    events_in_all: int


def explanation(recording: Recording) -> Explanation:
    """Return the story of a recorded run."""
    source = RunSource(recording, Budget())
    begin_ns, end_ns = source.span_ns
    seconds = (end_ns - begin_ns) * 1e-9
    estimates = estimates_of(source)
    tracks = [*tracks_of(source), *(each.track for each in estimates)]
    found, of_time = [], {}
    for each in estimates:
        spans = verdicts(each, seconds)
        if spans:
            of_time[each.track.name] = shares((span.status, span.end - span.begin) for span in spans)
        found += [Verdict(each.track.name, *span, _error(each.track, tracks, span)) for span in spans]
    recorded, in_all = events_of(source)
    own = [event for event in recorded if not event.text.startswith(_OWN_WORDS)]
    end = recording.end
    return Explanation(
        title=printable(title_of(recording)),
        seed=recording.header.seed,
        complete=end is not None and end.complete and not recording.truncated,
        ended=printable(ended(end.reason, end.outcome)) if end is not None else "its end was never written",
        seconds=seconds,
        shares=of_time,
        verdicts=sorted(found, key=lambda verdict: verdict.begin),
        events=own,
        events_in_all=in_all - (len(recorded) - len(own)),
    )


def in_words(story: Explanation) -> list[str]:
    """Return the story as lines for a person: verdicts and events in the order of time."""
    state = "complete" if story.complete else "INCOMPLETE"
    lines = [f"{story.title} (seed {story.seed}): {state}, {story.ended}, {story.seconds:.1f} s"]
    for node, of_time in story.shares.items():
        told = ", ".join(f"{100.0 * share:.0f} % {_spoken(status)}" for status, share in of_time.items())
        lines.append(f"{printable(node)}: {told} of the time")
    if not story.shares:
        lines.append("no node of this run says how far its estimate is to be relied on")
    rows = [(verdict.begin, 1, _verdict_in_words(verdict)) for verdict in story.verdicts]
    rows += [(event.seconds, 0, [f"{event.node}: {event.text}"]) for event in story.events]
    for at, _, texts in sorted(rows, key=lambda row: row[:2]):
        lines.append(f"{at:9.1f} s  {texts[0]}")
        lines += [f"{'':13}{text}" for text in texts[1:]]
    left = story.events_in_all - len(story.events)
    return lines + ([f"and {left} events more"] if left > 0 else [])


def _verdict_in_words(verdict: Verdict) -> list[str]:
    lasted = f"for {verdict.end - verdict.begin:.1f} s"
    why = f": {printable(verdict.reason)}" if verdict.reason else ""
    texts = [f"{printable(verdict.node)} is {_spoken(verdict.status)}, {lasted}{why}"]
    if verdict.changed:
        texts.append(verdict.changed)
    if verdict.error_m is not None:
        texts.append(f"off by {verdict.error_m:.3g} m in the median")
    return texts


def _spoken(status: str) -> str:
    return status.replace("_", " ")


def _error(track: Track, tracks: Sequence[Track], span: Span) -> float | None:
    """Return the median error of a track within a span, m; None without a truth."""
    truth = next((each for each in tracks if each.role == "truth" and each.robot == track.robot), None)
    if truth is None:
        return None
    seconds, distance = position_errors(track, truth)
    within = distance[(seconds >= span.begin) & (seconds <= span.end)]
    return float(np.median(within)) if within.size else None


def as_data(story: Explanation) -> dict[str, Any]:
    """Return the story as ``dynpf explain --json`` prints it: without what is not known."""
    told = [verdict._asdict() for verdict in story.verdicts]
    known = [{name: value for name, value in each.items() if value is not None} for each in told]
    return {**story._asdict(), "verdicts": known, "events": [event._asdict() for event in story.events]}
