"""Messages in the shapes of Foxglove's well-known schemas, so that Foxglove and Lichtblick draw them."""

from enum import IntEnum
from typing import Annotated, Literal

from msgspec import Meta

from dynpf.portable import atan2, sincos
from dynpf_protocol.messages.base import Count, Message, NonNegative, Piece

__all__ = [
    "Color",
    "CompressedImage",
    "Duration",
    "FrameTransform",
    "FrameTransforms",
    "LaserScan",
    "Log",
    "LogLevel",
    "Point3",
    "Pose",
    "PoseInFrame",
    "PosesInFrame",
    "Quaternion",
    "Timestamp",
    "Vector3",
    "heading",
    "planar_pose",
    "timestamp",
]


class Timestamp(Piece, frozen=True, kw_only=True):
    """A point in time."""

    sec: Annotated[int, Meta(ge=0, lt=2**32)]  # s
    nsec: Annotated[int, Meta(ge=0, lt=10**9)]  # ns


class Duration(Piece, frozen=True, kw_only=True):
    """A length of time."""

    sec: Annotated[int, Meta(ge=-(2**31), lt=2**31)] = 0  # s
    nsec: Annotated[int, Meta(ge=0, lt=10**9)] = 0  # ns


class Vector3(Piece, frozen=True, kw_only=True):
    """A vector."""

    x: float = 0.0  # m
    y: float = 0.0
    z: float = 0.0


class Point3(Piece, frozen=True, kw_only=True):
    """A point."""

    x: float = 0.0  # m
    y: float = 0.0
    z: float = 0.0


class Quaternion(Piece, frozen=True, kw_only=True):
    """A rotation as a unit quaternion."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(Piece, frozen=True, kw_only=True):
    """Position and orientation."""

    position: Vector3
    orientation: Quaternion


class Color(Piece, frozen=True, kw_only=True):
    """Red, green, blue and opacity."""

    r: float  # 0 to 1, as are the others
    g: float
    b: float
    a: float = 1.0


class CompressedImage(Message, frozen=True, kw_only=True):
    """A camera frame; ``data`` is base64 text on the wire, as in Foxglove's JSON schemas."""

    schema_name = "foxglove.CompressedImage"
    timestamp: Timestamp
    frame_id: str
    data: bytes
    format: Literal["jpeg", "png"]


class PoseInFrame(Message, frozen=True, kw_only=True):
    """A pose at a time in a frame."""

    schema_name = "foxglove.PoseInFrame"
    timestamp: Timestamp
    frame_id: str
    pose: Pose


class PosesInFrame(Message, frozen=True, kw_only=True):
    """At most 200 poses for viewers, such as a decimated particle cloud."""

    schema_name = "foxglove.PosesInFrame"
    timestamp: Timestamp
    frame_id: str
    poses: Annotated[tuple[Pose, ...], Meta(max_length=200)]


class FrameTransform(Piece, frozen=True, kw_only=True):
    """The pose of the child frame in the parent frame."""

    timestamp: Timestamp
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(Message, frozen=True, kw_only=True):
    """Transforms between frames."""

    schema_name = "foxglove.FrameTransforms"
    transforms: Annotated[tuple[FrameTransform, ...], Meta(max_length=16)]


class LaserScan(Message, frozen=True, kw_only=True):
    """Ranges in metres over [start_angle, end_angle]; a beam without return reads the sensor's maximum range."""

    schema_name = "foxglove.LaserScan"
    timestamp: Timestamp
    frame_id: str
    pose: Pose
    start_angle: float  # rad
    end_angle: float  # rad
    ranges: Annotated[tuple[NonNegative, ...], Meta(max_length=100_000)]  # m
    intensities: Annotated[tuple[float, ...], Meta(max_length=100_000)] = ()


class LogLevel(IntEnum):
    """Severity of a log message."""

    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


class Log(Message, frozen=True, kw_only=True):
    """A text for people from a process."""

    schema_name = "foxglove.Log"
    timestamp: Timestamp
    level: LogLevel
    message: str
    name: str
    file: str = ""
    line: Count = 0


def timestamp(stamp_ns: int) -> Timestamp:
    """Return a logical stamp in nanoseconds as Foxglove's seconds and nanoseconds."""
    return Timestamp(sec=stamp_ns // 10**9, nsec=stamp_ns % 10**9)


def planar_pose(x: float, y: float, theta: float) -> Pose:
    """Return a pose in the plane (m, m, rad) as position and quaternion."""
    sine, cosine = sincos(theta / 2)
    return Pose(position=Vector3(x=x, y=y), orientation=Quaternion(z=sine, w=cosine))


def heading(orientation: Quaternion) -> float:
    """Return the yaw in radians of a rotation about z."""
    return 2.0 * atan2(float(orientation.z), float(orientation.w))
