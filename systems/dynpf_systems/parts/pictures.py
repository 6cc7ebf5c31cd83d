"""PARTS from above: the workspace, parts true and estimated, their goals; and the discs found in camera frames."""

from collections.abc import Callable, Sequence

import numpy as np
from dynpf_experiments.pictures.drawing import Circle, Drawing, Line, Pictures, Plot, Shape, Track
from dynpf_experiments.pictures.source import RunSource

from dynpf.portable import hypot
from dynpf.types import FloatArray
from dynpf.vision import Board, CalibrationError
from dynpf.vision.projection import PlaneProjection
from dynpf_systems.parts.messages import Detections, PartsEstimate, PartsState
from dynpf_systems.parts.task import RearrangementTask, walls_of
from dynpf_systems.parts.vision_config import VisionConfig

__all__ = ["PICTURES"]

REPLACED = frozenset({"walls", "goals", "parts", "robot"})
MOST_PARTS = 24


def _draw(source: RunSource) -> Drawing | None:
    task = None if source.scenario is None else source.scenario.task
    if task is None:
        return None
    goals = [
        Shape("disc", np.array(part.goal)[:, None], "goal", radius=part.radius, text=str(number))
        for number, part in enumerate(task.parts[:MOST_PARTS], start=1)
    ]
    true = _true_parts(source, task)
    return Drawing(
        shapes=[Shape("pairs", walls_of(task).reshape(-1, 2).T, "wall"), *goals],
        tracks=[*true, *_estimated_parts(source, task)],
        plots=_distances(true, task),
        circles=_found_discs(source),
        replaced=REPLACED,
        radii={"": task.robot_radius},
    )


def _true_parts(source: RunSource, task: RearrangementTask) -> list[Track]:
    known = [(at, m) for at, m in source.messages("truth/parts") if isinstance(m, PartsState)]
    tracks = []
    for number, part in enumerate(task.parts[:MOST_PARTS]):
        rows = [(at, m.parts[number].x, m.parts[number].y) for at, m in known if number < len(m.parts)]
        tracks.append(_track(f"part {number + 1}", rows, part.radius))
    return [track for track in tracks if track.seconds.size]


def _estimated_parts(source: RunSource, task: RearrangementTask) -> list[Track]:
    """Return the estimated positions: without a size, so that they are drawn as points inside the true discs."""
    known = [(at, m) for at, m in source.messages("estimator/parts") if isinstance(m, PartsEstimate)]
    tracks = []
    for number in range(min(len(task.parts), MOST_PARTS)):
        rows = [(at, m.parts[number].x, m.parts[number].y) for at, m in known if number < len(m.parts)]
        tracks.append(_track(f"estimate of part {number + 1}", rows, 0.0))
    return [track for track in tracks if track.seconds.size]


def _track(name: str, rows: list[tuple[float, float, float]], radius: float) -> Track:
    table = np.array(rows).reshape(-1, 3)
    poses = np.stack([table[:, 1], table[:, 2], np.zeros(len(table))])
    return Track(name, "body", "", table[:, 0], poses, radius=radius)


def _distances(true: Sequence[Track], task: RearrangementTask) -> list[Plot]:
    """Return how far each part is from its goal."""
    lines = [
        Line(track.name, track.seconds, _distance(track.poses[:2], part.goal))
        for track, part in zip(true, task.parts, strict=False)
    ]
    return [Plot("to_goal", "Distance of parts to their goals", "m", lines)] if lines else []


def _distance(positions: FloatArray, goal: tuple[float, float]) -> FloatArray:
    x, y = positions - np.array(goal)[:, None]
    return np.asarray(hypot(x, y))


def _found_discs(source: RunSource) -> dict[str, Callable[[int], list[Circle]]]:
    """Return what vision found in each frame, in its pixels; nothing where it calibrates itself by a board."""
    vision = None if source.scenario is None else source.scenario.vision
    if not isinstance(vision, VisionConfig) or vision.calibration is None or isinstance(vision.calibration, Board):
        return {}
    try:
        projection = vision.calibrated().projection
    except CalibrationError:
        return {}
    by_stamp = {record.stamp_ns: record for record in source.records("vision/detections")}

    def circles(stamp_ns: int) -> list[Circle]:
        """Return the discs found in the frame of a stamp."""
        record = by_stamp.get(stamp_ns)
        found = None if record is None else source.decoded(record)
        if not isinstance(found, Detections):
            return []
        return [_circle(projection, disc.x, disc.y, disc.radius) for disc in found.discs]

    return {"camera/image": circles}


def _circle(projection: PlaneProjection, x: float, y: float, radius: float) -> Circle:
    (u, v), (side_u, side_v) = projection.to_pixels(np.array([(x, y), (x + radius, y)])).tolist()
    return Circle(u, v, float(hypot(side_u - u, side_v - v)))


PICTURES = Pictures(_draw)
