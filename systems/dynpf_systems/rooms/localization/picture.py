"""Pictures of the estimate: landmarks and robot as shapes in the map."""

from collections.abc import Sequence
from typing import NamedTuple

from dynpf_protocol import frames
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    ArrowPrimitive,
    Color,
    CylinderPrimitive,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
    planar_pose,
)

__all__ = ["Drawn", "draw_landmarks", "draw_scene"]

LANDMARK = Color(r=0.55, g=0.3, b=0.65)
LABEL = Color(r=0.35, g=0.35, b=0.35)
ROBOT = Color(r=0.8, g=0.15, b=0.25)
DOUBTED = {"uncertain": Color(r=0.9, g=0.6, b=0.1), "lost": Color(r=0.5, g=0.5, b=0.5)}
"""The robot's colour where the estimate cannot be relied on."""


class Drawn(NamedTuple):
    """Landmarks as posts with their numbers."""

    posts: tuple[CylinderPrimitive, ...]
    labels: tuple[TextPrimitive, ...]


def draw_landmarks(landmarks: Sequence[Landmark]) -> Drawn:
    """Return the landmarks as numbered posts; they stay where they are."""
    return Drawn(tuple(_post(mark) for mark in landmarks), tuple(_label(mark) for mark in landmarks))


def draw_scene(
    x: float, y: float, theta: float, landmarks: Drawn, now: Timestamp, *, status: str = "tracking"
) -> SceneUpdate:
    """Return the landmarks as numbered posts and the estimated robot as an arrow, coloured by its health status."""
    arrow = ArrowPrimitive(
        pose=planar_pose(x, y, theta),
        shaft_length=0.2,
        shaft_diameter=0.06,
        head_length=0.15,
        head_diameter=0.15,
        color=DOUBTED.get(status, ROBOT),
    )
    posts, labels = landmarks
    return SceneUpdate(
        entities=(
            SceneEntity(timestamp=now, frame_id=frames.MAP, id="landmarks", cylinders=posts, texts=labels),
            SceneEntity(timestamp=now, frame_id=frames.MAP, id="estimated robot", arrows=(arrow,)),
        )
    )


def _post(mark: Landmark) -> CylinderPrimitive:
    size = Vector3(x=0.08, y=0.08, z=0.4)
    return CylinderPrimitive(pose=_at(mark, 0.2), size=size, bottom_scale=1.0, top_scale=1.0, color=LANDMARK)


def _label(mark: Landmark) -> TextPrimitive:
    return TextPrimitive(
        pose=_at(mark, 0.5), billboard=True, font_size=0.15, scale_invariant=False, color=LABEL, text=str(mark.id)
    )


def _at(mark: Landmark, z: float) -> Pose:
    return Pose(position=Vector3(x=mark.x, y=mark.y, z=z), orientation=Quaternion())
