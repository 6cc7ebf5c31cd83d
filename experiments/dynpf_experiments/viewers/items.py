"""What viewers are shown of a run, in the order of logical time.

Messages in Foxglove's shapes are those of the recording. Beside them: the map, each scan as points of the map's
frame, true poses, errors, health and measures as numbers; all else as it was recorded.
"""

import heapq
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_formats.recording.stream import RecordedSchema
from dynpf_protocol.journal import JOURNAL_PREFIX
from dynpf_protocol.messages import FrameTransforms, LaserScan, Message, PoseInFrame, RobotState, planar_pose, timestamp
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX
from dynpf_protocol.topics import Topic

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.portable import sincos
from dynpf.types import FloatArray
from dynpf_experiments.pictures.drawing import Shape, Unit
from dynpf_experiments.pictures.estimates import Span
from dynpf_experiments.pictures.tracks import greatest_range, scan_points
from dynpf_experiments.pictures.whole import Whole
from dynpf_experiments.viewers.shapes import MAP_FRAME, grid_of, picture_of, points_of

__all__ = ["FIGURES", "STATUSES", "Item", "Number", "Passing", "Plain", "items", "map_of"]

STATUSES = ("tracking", "uncertain", "lost", "kidnapped", "map_does_not_fit")
FIGURES = "figures"
MOST_POINTS = 100_000
_STEP_M = 0.05
_FORMS = {"line", "loop", "pairs"}


class Number(NamedTuple):
    """A value that is plotted over time, and words that belong to it."""

    value: float
    text: str = ""


class Plain(NamedTuple):
    """A message as it was recorded, JSON, with its schema; or one of numbers by name, without."""

    data: bytes
    schema: RecordedSchema | None


class Item(NamedTuple):
    """What a topic shows at a time."""

    topic: str
    stamp_ns: int
    shown: msgspec.Struct | Number | Plain


def items(run: Whole, measures: Mapping[str, Any]) -> Iterator[Item]:
    """Yield what viewers are shown of a run, whose ``measures`` are those of ``measure``, by logical time."""
    numbers = sorted([*_lines(run), *_health(run)], key=lambda item: item.stamp_ns)
    yield from map_of(run)
    yield from _measures(run, measures)
    yield from heapq.merge(_recorded(run), numbers, key=lambda item: item.stamp_ns)


class Passing:
    """What follows from each message of a run, recorded or heard.

    ``placed`` returns the estimated pose (x, y, theta) of a robot at a stamp, or None; ``greatest`` what a scanner
    reads where a beam meets nothing, by the namespace of its topics.
    """

    def __init__(
        self,
        topics: Mapping[str, Topic],
        placed: Callable[[str, int], Sequence[float] | None],
        greatest: Callable[[str], float],
    ) -> None:
        self._topics, self._placed, self._greatest = topics, placed, greatest
        self._children: dict[str, str] = {}

    def items(self, topic: str, stamp_ns: int, plain: Plain, message: Message | None) -> Iterator[Item]:
        """Yield what is shown of a message; ``plain`` is what it is as JSON, ``message`` None where it is not known."""
        if message is None or not message.schema_name.startswith("foxglove."):
            yield Item(topic, stamp_ns, plain)
        match message:
            case RobotState(heading_valid=True, x=x, y=y, theta=theta):
                pose = PoseInFrame(timestamp=timestamp(stamp_ns), frame_id=MAP_FRAME, pose=planar_pose(x, y, theta))
                yield Item(f"{topic}/pose", stamp_ns, pose)
            case FrameTransforms():
                yield Item(topic, stamp_ns, self._own_children(message, topic))
            case LaserScan():
                yield Item(topic, stamp_ns, message)
                seen = self._in_map(topic, stamp_ns, message)
                if seen is not None:
                    yield Item(f"{topic}/points", stamp_ns, points_of(seen, timestamp(stamp_ns)))
            case Message() if message.schema_name.startswith("foxglove."):
                yield Item(topic, stamp_ns, message)

    def _own_children(self, message: FrameTransforms, topic: str) -> FrameTransforms:
        """Return transforms of which each frame has one parent: a second estimator's robot is a frame of its own."""
        named = []
        for each in message.transforms:
            owner = self._children.setdefault(each.child_frame_id, topic)
            own = each.child_frame_id if owner == topic else f"{topic.rpartition('/')[0]}/{each.child_frame_id}"
            named.append(msgspec.structs.replace(each, child_frame_id=own))
        return FrameTransforms(transforms=tuple(named))

    def _in_map(self, topic: str, stamp_ns: int, scan: LaserScan) -> FloatArray | None:
        """Return the ends of a scan's beams (2, M), placed by an estimate; None where there is none.

        Of a log's record that a sensor passes on, the sensor's is placed.
        """
        passed_on = topic.replace("log/", "sensors/")
        node = topic.rpartition("/")[0]
        pose = self._placed(node.rpartition("/")[0], stamp_ns)
        if pose is None or (passed_on != topic and passed_on in self._topics):
            return None
        x, y, theta = pose
        sine, cosine = (float(value) for value in sincos(theta))
        points = scan_points(scan, self._greatest(node))
        return np.stack([x + cosine * points[0] - sine * points[1], y + sine * points[0] + cosine * points[1]])


def _recorded(run: Whole) -> Iterator[Item]:
    """Yield the recording's messages, and what follows from each."""
    source, recording = run.source, run.source.recording
    tracks = {each.track.robot: each.track for each in reversed(run.estimates)}

    def placed(robot: str, stamp_ns: int) -> Sequence[float] | None:
        track = tracks.get(robot)
        at = (stamp_ns - source.origin_ns) * 1e-9
        index = -1 if track is None else int(np.searchsorted(track.seconds, at + 1e-9)) - 1
        return None if track is None or index < 0 else [float(value) for value in track.poses[:, index]]

    there = {topic: row for topic, row in recording.topics.items() if topic in recording.schemas}
    passing = Passing(there, placed, cache(lambda node: greatest_range(source, f"{node}/scanner")))
    for record in sorted(recording.messages(), key=lambda record: record.stamp_ns):
        if not record.topic.startswith((JOURNAL_PREFIX, SNAPSHOT_PREFIX)):
            message = source.decoded(record) if record.topic in recording.topics else None
            plain = Plain(record.payload, recording.schemas[record.topic])
            yield from passing.items(record.topic, record.stamp_ns, plain, message)


def map_of(run: Whole) -> Iterator[Item]:
    """Yield the map as a grid, as an image and as points."""
    at = run.source.origin_ns
    stamp = timestamp(at)
    for grid in [_in_metres(each, run.drawing.unit) for each in (*run.drawing.grids, *run.drawing.cells)][:1]:
        yield Item("map/grid", at, grid_of(grid, stamp))
        yield Item("map/image", at, picture_of(grid, stamp))
    points = [_centres(_in_metres(grid, run.drawing.unit)) for grid in run.drawing.grids]
    points += [_along(shape) / run.drawing.unit.per_metre for shape in run.drawing.shapes if shape.form in _FORMS]
    points += [shape.points / run.drawing.unit.per_metre for shape in run.drawing.shapes if shape.part == "landmark"]
    if points:
        yield Item("map/points", at, points_of(np.concatenate(points, axis=1)[:, :MOST_POINTS], stamp))


def _in_metres(grid: OccupancyGrid, unit: Unit) -> OccupancyGrid:
    """Return a map that is drawn in another unit as one in metres."""
    if unit.per_metre == 1.0:
        return grid
    x, y, yaw = grid.origin
    return OccupancyGrid(grid.cells, grid.resolution / unit.per_metre, (x / unit.per_metre, y / unit.per_metre, yaw))


def _centres(grid: OccupancyGrid) -> FloatArray:
    """Return the centres of occupied cells, (2, M); of too many, some at even distances."""
    rows, columns = np.nonzero(grid.occupied)
    chosen = slice(None, None, -(-rows.size // MOST_POINTS) or 1)
    return np.stack(grid.to_map(columns[chosen] + 0.5, rows[chosen] + 0.5))


def _along(shape: Shape) -> FloatArray:
    """Return points along a shape's lines, (2, M), at most ``_STEP_M`` of its unit apart."""
    if shape.form == "pairs":
        begins, ends = shape.points[:, ::2], shape.points[:, 1::2]
    else:
        closed = shape.points if shape.form == "line" else np.concatenate([shape.points, shape.points[:, :1]], axis=1)
        begins, ends = closed[:, :-1], closed[:, 1:]
    found = []
    for begin, end in zip(begins.T, ends.T, strict=True):
        count = min(2000, max(2, int(np.sqrt(np.sum((end - begin) ** 2)) / _STEP_M)))
        found.append(begin[:, np.newaxis] + (end - begin)[:, np.newaxis] * np.linspace(0.0, 1.0, count))
    return np.concatenate(found, axis=1) if found else np.empty((2, 0))


def _measures(run: Whole, measures: Mapping[str, Any]) -> Iterator[Item]:
    """Yield the measures of the run as one message of numbers, those of several estimators by their names."""
    several = measures.get("estimators")
    tables = {"": measures, **(several if isinstance(several, Mapping) else {})}
    found = {
        f"{name}.{key}".removeprefix("."): float(value)
        for name, table in tables.items()
        for key, value in table.items()
        if isinstance(value, bool | int | float) and np.isfinite(value)
    }
    if found:
        data = msgspec.json.encode({_word(key): value for key, value in found.items()})
        yield Item(f"{FIGURES}/measures", run.source.origin_ns, Plain(data, None))


def _lines(run: Whole) -> Iterator[Item]:
    """Yield the lines of the run's plots: errors with 3 sigma, effective sample sizes, evidence, commands."""
    for plot in run.plots:
        for line in plot.lines:
            topic = f"{FIGURES}/{_word(plot.key)}/{_word(line.label)}"
            for at, value in zip(line.seconds.tolist(), line.values.tolist(), strict=True):
                if np.isfinite(value):
                    yield Item(topic, _stamp(run, at), Number(value))


def _health(run: Whole) -> Iterator[Item]:
    """Yield the verdicts of the filters: 0 for tracking, 1 uncertain, 2 lost and so on, at begin and end of each."""
    for node, spans in run.health.items():
        for span in spans:
            for at in (span.begin, span.end - 1e-6):
                yield Item(f"{FIGURES}/health/{_word(node)}", _stamp(run, max(at, span.begin)), _verdict(span))


def _verdict(span: Span) -> Number:
    known = span.status in STATUSES
    return Number(float(STATUSES.index(span.status)) if known else -1.0, f"{span.status}: {span.reason}")


def _stamp(run: Whole, seconds: float) -> int:
    return run.source.origin_ns + round(seconds * 1e9)


def _word(text: str) -> str:
    """Return a text as a part of a topic's name or of a path to a field."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_") or "value"
