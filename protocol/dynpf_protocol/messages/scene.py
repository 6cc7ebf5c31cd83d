"""Foxglove's scenes: shapes for viewers."""

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
    """Metadata of an entity."""

    key: str
    value: str


class SceneEntityDeletion(Piece, frozen=True, kw_only=True):
    """The deletion of one entity (type 0) or of all (type 1)."""

    timestamp: Timestamp
    type: Annotated[int, Meta(ge=0, le=1)]
    id: str


class ArrowPrimitive(Piece, frozen=True, kw_only=True):
    """An arrow along the x axis of its pose; metres."""

    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


class CubePrimitive(Piece, frozen=True, kw_only=True):
    """A cuboid; metres."""

    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(Piece, frozen=True, kw_only=True):
    """An ellipsoid; metres."""

    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(Piece, frozen=True, kw_only=True):
    """An elliptic cylinder or cone; metres."""

    pose: Pose
    size: Vector3
    bottom_scale: float
    top_scale: float
    color: Color


class LinePrimitive(Piece, frozen=True, kw_only=True):
    """Points joined to a line strip (type 0), a closed loop (1) or separate lines (2); metres."""

    type: Annotated[int, Meta(ge=0, le=2)]
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TriangleListPrimitive(Piece, frozen=True, kw_only=True):
    """Triangles, three points each; metres."""

    pose: Pose
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TextPrimitive(Piece, frozen=True, kw_only=True):
    """A text."""

    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class ModelPrimitive(Piece, frozen=True, kw_only=True):
    """A 3D model, by URL or as data."""

    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: bytes


class SceneEntity(Piece, frozen=True, kw_only=True):
    """Shapes that are shown and replaced together."""

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
    """Shapes for viewers: discs, goals, landmarks."""

    schema_name = "foxglove.SceneUpdate"
    deletions: tuple[SceneEntityDeletion, ...] = ()
    entities: tuple[SceneEntity, ...] = ()
