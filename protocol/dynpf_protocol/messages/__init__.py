"""Message types: frozen structs in SI units and radians.

Types named ``foxglove.*`` have the exact shape of Foxglove's well-known schemas, so that Foxglove and Lichtblick draw
them; types named ``dynpf.*`` are dynpf's own. Lengths, ranges and signs are part of the types: decoding checks them.
These are the messages that any robot may have; each system has its own.
"""

from dynpf_protocol.messages.base import Message, Piece
from dynpf_protocol.messages.estimates import (
    Estimate,
    FilterHealth,
    HealthFigures,
)
from dynpf_protocol.messages.foxglove import (
    Color,
    CompressedImage,
    Duration,
    FrameTransform,
    FrameTransforms,
    LaserScan,
    Log,
    LogLevel,
    Point3,
    Pose,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    Timestamp,
    Vector3,
    heading,
    planar_pose,
    timestamp,
)
from dynpf_protocol.messages.hosts import (
    Diagnostics,
    Gap,
    HostEvent,
    Snapshot,
)
from dynpf_protocol.messages.robot import (
    Command,
    RobotState,
)
from dynpf_protocol.messages.scene import (
    ArrowPrimitive,
    CubePrimitive,
    CylinderPrimitive,
    KeyValuePair,
    LinePrimitive,
    ModelPrimitive,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    TriangleListPrimitive,
)
from dynpf_protocol.messages.sensed import (
    LandmarkReading,
    LandmarkReadings,
    LineReading,
    LineReadings,
    Odometry,
    OdometryPose,
    PositionFix,
    Scanner,
)

__all__ = [
    "ArrowPrimitive",
    "Color",
    "Command",
    "CompressedImage",
    "CubePrimitive",
    "CylinderPrimitive",
    "Diagnostics",
    "Duration",
    "Estimate",
    "FilterHealth",
    "FrameTransform",
    "FrameTransforms",
    "Gap",
    "HealthFigures",
    "HostEvent",
    "KeyValuePair",
    "LandmarkReading",
    "LandmarkReadings",
    "LaserScan",
    "LinePrimitive",
    "LineReading",
    "LineReadings",
    "Log",
    "LogLevel",
    "Message",
    "ModelPrimitive",
    "Odometry",
    "OdometryPose",
    "Piece",
    "Point3",
    "Pose",
    "PoseInFrame",
    "PosesInFrame",
    "PositionFix",
    "Quaternion",
    "RobotState",
    "Scanner",
    "SceneEntity",
    "SceneEntityDeletion",
    "SceneUpdate",
    "Snapshot",
    "SpherePrimitive",
    "TextPrimitive",
    "Timestamp",
    "TriangleListPrimitive",
    "Vector3",
    "heading",
    "planar_pose",
    "timestamp",
]
