"""Foxglove's scenes: shapes for looking at."""

from typing import Annotated

from msgspec import Meta

from dynpf_protocol.messages.base import Count, Message, Piece
from dynpf_protocol.messages.foxglove import Color, Duration, Point3, Pose, Timestamp, Vector3

__all__ = [
    "ArrowPrimitive",
    "CubePrimitive",
    "CylinderPrimitive",
    "KeyValuePair",
    "LinePrimitive",
    "ModelPrimitive",
    "SceneEntity",
    "SceneEntityDeletion",
    "SceneUpdate",
    "SpherePrimitive",
    "TextPrimitive",
    "TriangleListPrimitive",
]


class KeyValuePair(Piece, frozen=True, kw_only=True):
    key: str
    value: str


class SceneEntityDeletion(Piece, frozen=True, kw_only=True):
    timestamp: Timestamp
    type: Annotated[int, Meta(ge=0, le=1)]
    id: str


class ArrowPrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


class CubePrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    bottom_scale: float
    top_scale: float
    color: Color


class LinePrimitive(Piece, frozen=True, kw_only=True):
    type: Annotated[int, Meta(ge=0, le=2)]
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TriangleListPrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TextPrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class ModelPrimitive(Piece, frozen=True, kw_only=True):
    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: bytes


class SceneEntity(Piece, frozen=True, kw_only=True):
    timestamp: Timestamp
    frame_id: str
    id: str
    lifetime: Duration = Duration()
    frame_locked: bool = False
    metadata: tuple[KeyValuePair, ...] = ()
    arrows: tuple[ArrowPrimitive, ...] = ()
    cubes: tuple[CubePrimitive, ...] = ()
    spheres: tuple[SpherePrimitive, ...] = ()
    cylinders: tuple[CylinderPrimitive, ...] = ()
    lines: tuple[LinePrimitive, ...] = ()
    triangles: tuple[TriangleListPrimitive, ...] = ()
    texts: tuple[TextPrimitive, ...] = ()
    models: tuple[ModelPrimitive, ...] = ()


class SceneUpdate(Message, frozen=True, kw_only=True):
    """Shapes for looking at: discs, goals, landmarks."""

    schema_name = "foxglove.SceneUpdate"
    deletions: tuple[SceneEntityDeletion, ...] = ()
    entities: tuple[SceneEntity, ...] = ()
