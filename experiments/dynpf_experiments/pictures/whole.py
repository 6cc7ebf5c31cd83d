"""All that can be drawn of a run, read from its recording once: for pages and for figures."""

from typing import NamedTuple

from dynpf_formats.recording.reader import Recording
from dynpf_formats.shipped import listed, load

from dynpf_experiments.pictures.commands import command_plots
from dynpf_experiments.pictures.drawing import Drawing, Pictures, Plot, Track, merged
from dynpf_experiments.pictures.estimates import (
    Estimated,
    Span,
    error_plots,
    estimates_of,
    filter_plots,
    verdicts,
)
from dynpf_experiments.pictures.scenes import scenes_of
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_experiments.pictures.tracks import Clouds, clouds_of, tracks_of

__all__ = ["Whole", "whole", "whole_of"]


class Whole(NamedTuple):
    """The world, all that moves in it, particles, plots over time, and verdicts by node."""

    source: RunSource
    drawing: Drawing
    tracks: list[Track]
    estimates: list[Estimated]
    clouds: list[Clouds]
    plots: list[Plot]
    health: dict[str, list[Span]]

    @property
    def seconds(self) -> float:
        """How long the run is, s."""
        begin, end = self.source.span_ns
        return (end - begin) * 1e-9


def whole(recording: Recording, budget: Budget | None = None) -> Whole:
    """Return what can be drawn of a recording, within a budget."""
    return whole_of(RunSource(recording, budget or Budget()))


def whole_of(source: RunSource) -> Whole:
    """Return what can be drawn of the messages of a source."""
    estimates = estimates_of(source)
    drawing = _drawing(source)
    tracks = [*tracks_of(source), *(estimated.track for estimated in estimates), *drawing.tracks]
    tracks = [each if each.role == "body" else _sized(each, drawing) for each in tracks]
    shapes, layers = scenes_of(source, drawing.replaced, drawing.unit.per_metre)
    drawing = drawing._replace(shapes=[*drawing.shapes, *shapes], layers=[*drawing.layers, *layers])
    clouds = clouds_of(source, drawing.unit.per_metre)
    plots = [*error_plots(tracks, drawing.unit.name), *drawing.plots, *filter_plots(estimates), *command_plots(source)]
    begin, end = source.span_ns
    health = {each.track.name: verdicts(each, (end - begin) * 1e-9) for each in estimates}
    return Whole(source, drawing, tracks, estimates, clouds, plots, health)


def _sized(track: Track, drawing: Drawing) -> Track:
    """Return a robot's track with the robot's size."""
    return track._replace(radius=track.radius or drawing.radii.get(track.robot, 0.0))


def _drawing(source: RunSource) -> Drawing:
    """Return what the systems draw of a run."""
    pictures: list[Pictures] = [load(text) for text in listed("PICTURES")]
    drawn = (each.draw(source) for each in pictures)
    return merged([drawing for drawing in drawn if drawing is not None])
