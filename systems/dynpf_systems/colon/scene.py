"""Pictures of a capsule in its tube, as shapes: a pixel is drawn as a centimetre, since pictures are in metres."""

import cv2
import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import (
    ArrowPrimitive,
    Color,
    LinePrimitive,
    Point3,
    Pose,
    SceneEntity,
    TextPrimitive,
    Timestamp,
    planar_pose,
)

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.types import FloatArray

__all__ = ["M_PER_PX", "arrow_entity", "drawn_pose", "tube_entity", "walls_entity"]

M_PER_PX = 0.01
"""Size of a drawn pixel."""

LOOP, PAIRS = 1, 2  # how Foxglove's lines connect their points
LABEL_OFF_PX = 15.0


def drawn_pose(x_px: float, y_px: float, theta: float) -> Pose:
    """Return the drawn pose of a pose in pixels."""
    return planar_pose(M_PER_PX * x_px, M_PER_PX * y_px, theta)


def tube_entity(
    grid: OccupancyGrid, label: str, now: Timestamp, name: str, color: Color, *, above: bool
) -> SceneEntity:
    """Return the outline of a bore, to within a pixel, with a label above or below it."""
    contours, _ = cv2.findContours(grid.free.astype(np.uint8, casting="safe"), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    rings = [cv2.approxPolyDP(contour, 1.0, closed=True)[:, 0] for contour in contours]
    lines = tuple(_line(LOOP, np.stack(grid.to_map(*(ring.T + 0.5))), color) for ring in rings)
    columns, rows = np.concatenate(rings).T
    x, y = grid.to_map(columns.mean(), rows.max() + LABEL_OFF_PX if above else rows.min() - LABEL_OFF_PX)
    text = TextPrimitive(
        pose=drawn_pose(float(x), float(y), 0.0),
        billboard=True,
        font_size=0.2,
        scale_invariant=False,
        color=color,
        text=label,
    )
    return SceneEntity(timestamp=now, frame_id=frames.MAP, id=name, lines=lines, texts=(text,))


def walls_entity(ends: FloatArray, now: Timestamp, name: str, color: Color) -> SceneEntity:
    """Return the displacements of walls as lines between points ``ends[0]`` and ``ends[1]``, (2, 2, M) in pixels."""
    points = np.moveaxis(ends, 2, 0).reshape(-1, 2).T
    lines = (_line(PAIRS, points, color),) if points.size else ()
    return SceneEntity(timestamp=now, frame_id=frames.MAP, id=name, lines=lines)


def arrow_entity(pose: FloatArray, now: Timestamp, name: str, color: Color) -> SceneEntity:
    """Return the capsule at a pose (3,) in pixels as an arrow."""
    x, y, theta = pose.tolist()
    arrow = ArrowPrimitive(
        pose=drawn_pose(x, y, theta),
        shaft_length=0.2,
        shaft_diameter=0.08,
        head_length=0.12,
        head_diameter=0.16,
        color=color,
    )
    return SceneEntity(timestamp=now, frame_id=frames.MAP, id=name, arrows=(arrow,))


def _line(kind: int, points: FloatArray, color: Color) -> LinePrimitive:
    """Return a line through points (2, M) in pixels."""
    return LinePrimitive(
        type=kind,
        pose=planar_pose(0.0, 0.0, 0.0),
        thickness=0.02,
        scale_invariant=False,
        points=tuple(Point3(x=x, y=y) for x, y in (M_PER_PX * points).T.tolist()),
        color=color,
    )
