"""A run as the data of a page: plain and bounded, with finite numbers only; and what sets two runs apart."""

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from dynpf_formats.recording.diff import diff
from dynpf_formats.recording.info import ended, title_of
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.printable import printable

from dynpf.types import FloatArray
from dynpf_experiments.measures import differing, lines_of
from dynpf_experiments.pictures import packing
from dynpf_experiments.pictures.cameras import Camera, cameras_of
from dynpf_experiments.pictures.columns import column, evenly
from dynpf_experiments.pictures.drawing import Track
from dynpf_experiments.pictures.estimates import Span
from dynpf_experiments.pictures.event import Event
from dynpf_experiments.pictures.events import events_of, faults_of
from dynpf_experiments.pictures.executed import with_executed
from dynpf_experiments.pictures.figures import Figure, figures
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_experiments.pictures.tracks import Clouds, Readings, readings_of
from dynpf_experiments.pictures.whole import whole

__all__ = ["Apart", "Head", "RunPicture", "apart", "measures_in_words", "run_picture"]

MOST_ROWS = 60

_ELSEWHERE = frozenset({"NEES", "lost", "health"})
"""Measures that a page does not say in its first words: plots, timeline and table have them."""

Others = tuple[Sequence[Clouds], Sequence[Readings], Sequence[Camera]]


class Head(NamedTuple):
    """What a run is: texts for its heading and its tables."""

    title: str
    file: str
    seed: int
    complete: bool
    state: str
    clock: str
    begin_ns: int
    seconds: float
    ticks: int
    messages: int
    missing: int | None
    digest: str
    versions: list[tuple[str, str]]
    lines: list[tuple[str, str]]
    replay: str


class RunPicture(NamedTuple):
    """What a page tells of a run in words, and as ``data`` what it draws: numbers, lists and texts only."""

    head: Head
    figures: dict[str, list[Figure]]  # of the run, or of each of its estimators by name
    health: dict[str, list[Span]]
    events: list[Event]
    events_in_all: int
    faults: list[str]
    notes: list[str]
    data: dict[str, Any]


class Apart(NamedTuple):
    """What sets two runs apart: the first difference in words and its tick, topics and measures that differ."""

    same: bool
    first: str
    tick: int | None
    topics: list[tuple[str, int, int, int]]
    measures: list[tuple[str, str, str]]


def run_picture(
    recording: Recording, measures: Mapping[str, Any], budget: Budget, executed: Sequence[Clouds] = ()
) -> RunPicture:
    """Return what a page shows of a recording, whose ``measures`` are those of ``measure``.

    ``executed`` are clouds of particles that are drawn in the place of those recorded.

    Raises a RecordingError where the file is found to be damaged only now.
    """
    run = whole(recording, budget)
    source, drawing = run.source, run.drawing
    clouds, readings = with_executed(run.clouds, executed, budget.clouds), readings_of(source)
    cameras = cameras_of(source, drawing.circles)
    events, in_all = events_of(source)
    at, ticks = _moments(source, run.tracks)
    head = _head(source, measures, ticks)
    chosen = evenly(at.size, budget.moments)
    tracks = [each for each in run.tracks if each.seconds.size]
    thinned = [packing.thinned(each, at[chosen]) for each in tracks]
    fixed = [*drawing.shapes, *(each for one in drawing.layers for shapes in one.shapes for each in shapes)]
    data = {
        "unit": drawing.unit.name,
        "seconds": round(head.seconds, 3),
        "bounds": list(packing.bounds_of(fixed, drawing.grids, tracks)),
        "moments": {"t": column(at[chosen], packing.SECOND), "tick": column(ticks[chosen], 1.0)},
        "grids": [packing.grid(each) for each in drawing.grids],
        "shapes": [packing.shape(each) for each in drawing.shapes],
        "layers": [packing.layer(each) for each in drawing.layers],
        "tracks": [packing.track(each) for each in thinned],
        "clouds": [packing.cloud(each) for each in clouds],
        "readings": [packing.reading(each) for each in readings],
        "plots": [packing.plot(each, budget.values) for each in run.plots],
        "health": [
            {"node": printable(node, 80), "spans": [list(span) for span in spans]}
            for node, spans in run.health.items()
            if spans
        ],
        "events": [list(event) for event in events],
        "cameras": [packing.camera(each) for each in cameras if each.frames],
    }
    poses = {a.name: (a.seconds.size, b.seconds.size) for a, b in zip(thinned, tracks, strict=True)}
    notes = _notes(source, poses, (clouds, readings, cameras))
    return RunPicture(head, _figures(measures), run.health, events, in_all, faults_of(source), notes, data)


def apart(a: Recording, b: Recording) -> Apart:
    """Return what sets two runs apart."""
    difference = diff(a, b)
    first, words = difference.first, "none: both have the same content"
    if first is not None:
        tick = "no tick" if first.tick is None else f"tick {first.tick}"
        values = f"{printable(str(first.a), 80)} and {printable(str(first.b), 80)}"
        words = f"{tick}, node {first.node}, {first.topic} {first.sequence}, field {first.field}: {values}"
    topics = [(name, count.a, count.b, count.differ) for name, count in difference.counts.items() if count.differ]
    measures = [(name, _told(left), _told(right)) for name, (left, right) in differing(a, b).items()]
    tick_number = None if first is None else first.tick
    return Apart(difference.same, printable(words), tick_number, topics[:MOST_ROWS], measures[:MOST_ROWS])


def _moments(source: RunSource, tracks: Sequence[Track]) -> tuple[FloatArray, FloatArray]:
    """Return the times of the slider and their ticks: those of the run, or else of all that moves, without ticks."""
    seconds, ticks = source.ticks()
    if not seconds.size:
        seconds = np.unique(np.concatenate([np.zeros(1), *(track.seconds for track in tracks)]))
        return seconds, np.full(seconds.size, np.nan)
    order = np.argsort(seconds, kind="stable")
    return seconds[order], ticks[order].astype(np.float64)


def _head(source: RunSource, measures: Mapping[str, Any], ticks: FloatArray) -> Head:
    recording = source.recording
    header, end = recording.header, recording.end
    begin, last = source.span_ns
    made = header.provenance
    complete = bool(measures["complete"])
    reason = "its end was never written" if end is None else ended(end.reason, end.outcome)
    versions = [("dynpf", f"{made.dynpf_version}, code {made.code_digest[:12]}"), *made.packages.items()]
    return Head(
        title=printable(title_of(recording)),
        file=printable(recording.path.name),
        seed=header.seed,
        complete=complete,
        state=f"{'complete' if complete else 'INCOMPLETE'}: {printable(reason)}",
        clock=printable(header.clock, 40),
        begin_ns=begin,
        seconds=(last - begin) * 1e-9,
        ticks=int(np.nanmax(ticks, initial=-1.0)) + 1 if np.isfinite(ticks).any() else 0,
        messages=int(measures["messages"]),
        missing=measures["gaps"],
        digest=str(measures["content_digest"]),
        versions=[(printable(name, 80), printable(text, 80)) for name, text in versions[:MOST_ROWS]],
        lines=measures_in_words(measures),
        replay=printable(_replay(recording)),
    )


def measures_in_words(measures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the measures in a few words: what ``dynpf run`` says of them, or a line for each of several estimators."""
    several = measures.get("estimators")
    if isinstance(several, Mapping):
        first = ((str(name), figures(each)[:2]) for name, each in several.items())
        return [
            (name, ", ".join(f"{row.label} {row.value} {row.unit}" for row in told)) for name, told in first if told
        ]
    rows: list[tuple[str, str]] = []
    for line in lines_of(measures):
        name, *texts = re.split(r" {2,}", line, maxsplit=1)
        if texts and not name and rows:  # the line before goes on
            name, before = rows.pop()
            texts = [f"{before.removesuffix('.')}. {texts[0]}"]
        rows += [(name, text) for text in texts]
    return [(name, text) for name, text in rows if name not in _ELSEWHERE]


def _replay(recording: Recording) -> str:
    """Return the command that executes a run again, for an imported log the one that describes it.

    Code that the recording names is not allowed by it: whoever copies a command should not do so unseen.
    """
    return shlex.join(["dynpf", "replay" if recording.header.writes else "info", recording.path.name])


def _figures(measures: Mapping[str, Any]) -> dict[str, list[Figure]]:
    several = measures.get("estimators")
    if isinstance(several, Mapping):
        return {str(name): figures(each) for name, each in several.items()}
    return {"": figures(measures)}


def _notes(source: RunSource, poses: Mapping[str, tuple[int, int]], others: Others) -> list[str]:
    """Return what the page leaves out, a sentence each; ``poses`` are those shown and those recorded, by track."""
    clouds, readings, cameras = others
    counted = [
        *((f"poses of {printable(name)}", shown, told) for name, (shown, told) in poses.items()),
        *((f"clouds of particles of {printable(each.node)}", len(each.points), each.told) for each in clouds),
        *((f"messages of {printable(each.topic)}", len(each.points), each.told) for each in readings),
        *((f"frames of {printable(each.topic)}, as thumbnails", len(each.frames), each.told) for each in cameras),
    ]
    notes = [f"{shown} of {told} {what}" for what, shown, told in counted if shown < told]
    if source.unreadable:
        notes.append(f"{source.unreadable} messages do not decode and are left out")
    return notes[:MOST_ROWS]


def _told(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else printable(str(value), 80)
