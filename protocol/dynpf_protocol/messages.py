"""Message types: one frozen struct a topic, in SI units and radians.

Types named ``foxglove.*`` have the exact shape of Foxglove's well-known schemas, so that Foxglove and Lichtblick draw
them; types named ``dynpf.*`` are ours. Lengths, ranges and signs are part of the types: decoding checks them.
"""

from enum import IntEnum
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType
from numpy.typing import NDArray

from dynpf.portable import atan2, sincos

__all__ = [
    "Barrier",
    "CapsuleEstimate",
    "CapsuleMove",
    "CapsuleReading",
    "CapsuleState",
    "Color",
    "Command",
    "CompressedImage",
    "Detection",
    "Detections",
    "Diagnostics",
    "Disc",
    "Duration",
    "Estimate",
    "FilterHealth",
    "FrameTransform",
    "FrameTransforms",
    "Gap",
    "Gripper",
    "HealthFigures",
    "HostEvent",
    "LandmarkReading",
    "LandmarkReadings",
    "LaserScan",
    "LineReading",
    "LineReadings",
    "Log",
    "LogLevel",
    "MapProbability",
    "Message",
    "MovedWall",
    "Obstacles",
    "Odometry",
    "OdometryPose",
    "PartEstimate",
    "PartState",
    "PartsState",
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
    "Timestamp",
    "Vector3",
    "heading",
    "planar_pose",
    "planar_poses",
    "timestamp",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
Count = Annotated[int, Meta(ge=0)]


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A piece of a message; has no topic of its own."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a topic carries. ``schema_name`` is the name under which a recording files its schema."""

    schema_name: ClassVar[str]


# --- Foxglove's well-known shapes ----------------------------------------------------------------------------------


class Timestamp(Part, frozen=True, kw_only=True):
    sec: Annotated[int, Meta(ge=0, lt=2**32)]  # s
    nsec: Annotated[int, Meta(ge=0, lt=10**9)]  # ns


class Duration(Part, frozen=True, kw_only=True):
    sec: Annotated[int, Meta(ge=-(2**31), lt=2**31)] = 0  # s
    nsec: Annotated[int, Meta(ge=0, lt=10**9)] = 0  # ns


class Vector3(Part, frozen=True, kw_only=True):
    x: float = 0.0  # m
    y: float = 0.0
    z: float = 0.0


class Point3(Part, frozen=True, kw_only=True):
    x: float = 0.0  # m
    y: float = 0.0
    z: float = 0.0


class Quaternion(Part, frozen=True, kw_only=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class Pose(Part, frozen=True, kw_only=True):
    position: Vector3
    orientation: Quaternion


class Color(Part, frozen=True, kw_only=True):
    r: float  # 0 to 1, as are the others
    g: float
    b: float
    a: float = 1.0


class CompressedImage(Message, frozen=True, kw_only=True):
    """A camera frame; ``data`` is base64 text on the wire, as JSON schemas of Foxglove have it."""

    schema_name = "foxglove.CompressedImage"
    timestamp: Timestamp
    frame_id: str
    data: bytes
    format: Literal["jpeg", "png"]


class PoseInFrame(Message, frozen=True, kw_only=True):
    schema_name = "foxglove.PoseInFrame"
    timestamp: Timestamp
    frame_id: str
    pose: Pose


class PosesInFrame(Message, frozen=True, kw_only=True):
    """Poses for looking at, such as a decimated particle cloud: at most 200."""

    schema_name = "foxglove.PosesInFrame"
    timestamp: Timestamp
    frame_id: str
    poses: Annotated[tuple[Pose, ...], Meta(max_length=200)]


class FrameTransform(Part, frozen=True, kw_only=True):
    """Where the child frame lies in the parent frame."""

    timestamp: Timestamp
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(Message, frozen=True, kw_only=True):
    schema_name = "foxglove.FrameTransforms"
    transforms: Annotated[tuple[FrameTransform, ...], Meta(max_length=16)]


class LaserScan(Message, frozen=True, kw_only=True):
    """Ranges in metres over [start_angle, end_angle]; a beam without return carries the sensor's maximum range."""

    schema_name = "foxglove.LaserScan"
    timestamp: Timestamp
    frame_id: str
    pose: Pose
    start_angle: float  # rad
    end_angle: float  # rad
    ranges: Annotated[tuple[NonNegative, ...], Meta(max_length=100_000)]  # m
    intensities: Annotated[tuple[float, ...], Meta(max_length=100_000)] = ()


class LogLevel(IntEnum):
    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


class Log(Message, frozen=True, kw_only=True):
    schema_name = "foxglove.Log"
    timestamp: Timestamp
    level: LogLevel
    message: str
    name: str
    file: str = ""
    line: Count = 0


class KeyValuePair(Part, frozen=True, kw_only=True):
    key: str
    value: str


class SceneEntityDeletion(Part, frozen=True, kw_only=True):
    timestamp: Timestamp
    type: Annotated[int, Meta(ge=0, le=1)]
    id: str


class ArrowPrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


class CubePrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    size: Vector3
    bottom_scale: float
    top_scale: float
    color: Color


class LinePrimitive(Part, frozen=True, kw_only=True):
    type: Annotated[int, Meta(ge=0, le=2)]
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TriangleListPrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    points: tuple[Point3, ...]
    color: Color
    colors: tuple[Color, ...] = ()
    indices: tuple[Count, ...] = ()


class TextPrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class ModelPrimitive(Part, frozen=True, kw_only=True):
    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: bytes


class SceneEntity(Part, frozen=True, kw_only=True):
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


# --- the true state ------------------------------------------------------------------------------------------------


class RobotState(Message, frozen=True, kw_only=True):
    """The robot's true or reference pose; ``heading_valid`` is false where the reference's heading is known to lie."""

    schema_name = "dynpf.RobotState"
    x: float  # m
    y: float  # m
    theta: float  # rad
    v: float = 0.0  # m/s
    w: float = 0.0  # rad/s
    heading_valid: bool = True


class PartState(Part, frozen=True, kw_only=True):
    x: float  # m
    y: float  # m
    radius: Positive  # m
    goal_x: float  # m
    goal_y: float  # m


class PartsState(Message, frozen=True, kw_only=True):
    """The true state of every part; ``held`` is the index of the part in the gripper, or -1."""

    schema_name = "dynpf.PartsState"
    parts: Annotated[tuple[PartState, ...], Meta(max_length=64)]
    held: Annotated[int, Meta(ge=-1, lt=64)]
    contacts: Count  # ticks so far in which two discs, or a disc and a wall, overlapped
    finished: bool  # the controller has said that it is done
    hidden: Annotated[tuple[Annotated[int, Meta(ge=0, lt=64)], ...], Meta(max_length=64)] = ()  # seen by no camera


class CapsuleMove(Part, frozen=True, kw_only=True):
    """A turn, and then the way ahead."""

    rho_px: float  # px
    turn: Angle  # rad


class CapsuleState(Message, frozen=True, kw_only=True):
    """The true pose of the capsule in its tube at a reading, and the name of the map that then holds."""

    schema_name = "dynpf.CapsuleState"
    reading: Count  # its number: 0 at the start, then one for each motion
    x_px: float  # px
    y_px: float  # px
    theta: Angle  # rad
    map: str
    move: CapsuleMove | UnsetType = UNSET  # that it was told to make since the reading before; left out at the start


class Disc(Part, frozen=True, kw_only=True):
    x: float  # m
    y: float  # m
    radius: Positive  # m


class Barrier(Part, frozen=True, kw_only=True):
    """A straight piece from one end to the other."""

    x1: float  # m
    y1: float  # m
    x2: float  # m
    y2: float  # m


class Obstacles(Message, frozen=True, kw_only=True):
    """What stands in the way just now and is in no map: people as discs, and the doors that are closed."""

    schema_name = "dynpf.Obstacles"
    people: Annotated[tuple[Disc, ...], Meta(max_length=256)] = ()
    doors: Annotated[tuple[Barrier, ...], Meta(max_length=256)] = ()


# --- what is sensed ------------------------------------------------------------------------------------------------


class Detection(Part, frozen=True, kw_only=True):
    """A disc in workspace coordinates; ``grey`` is its median grey level less the background's."""

    x: float  # m
    y: float  # m
    radius: Positive  # m
    grey: float  # grey levels, 0 to 255, less the background's
    residual: NonNegative = 0.0  # m, RMS distance of the edge points from the fitted circle


class Detections(Message, frozen=True, kw_only=True):
    schema_name = "dynpf.Detections"
    discs: Annotated[tuple[Detection, ...], Meta(max_length=256)]


class Odometry(Message, frozen=True, kw_only=True):
    """Forward speed (m/s) and turning rate (rad/s), held until the next message."""

    schema_name = "dynpf.Odometry"
    v: float  # m/s
    w: float  # rad/s


class OdometryPose(Message, frozen=True, kw_only=True):
    """Where odometry alone puts the robot, in a frame of its own: what tells is the motion from one to the next."""

    schema_name = "dynpf.OdometryPose"
    x: float  # m
    y: float  # m
    theta: Angle  # rad


class LandmarkReading(Part, frozen=True, kw_only=True):
    landmark: Annotated[int, Meta(ge=0)]  # its number
    range: NonNegative  # m
    bearing: Angle  # rad, from the robot's heading, left is positive
    x: float | UnsetType = UNSET  # m, where a landmark that moves was then; without, it stands where the map says
    y: float | UnsetType = UNSET  # m


class LandmarkReadings(Message, frozen=True, kw_only=True):
    """Range and bearing to identified landmarks, all taken at the message's stamp."""

    schema_name = "dynpf.LandmarkReadings"
    readings: Annotated[tuple[LandmarkReading, ...], Meta(max_length=256)]


class Scanner(Message, frozen=True, kw_only=True):
    """What the scanner measures between whose scans follow; sent before the first of them, and where it changes."""

    schema_name = "dynpf.Scanner"
    range_min: NonNegative = 0.0  # m; a range below it tells nothing
    range_max: Positive  # m, which a beam without return reads


class LineReading(Part, frozen=True, kw_only=True):
    """A straight piece of wall, in polar form: the line's distance, and the direction in which it is nearest."""

    rho: NonNegative  # m, from the robot to the line
    alpha: Angle  # rad, of the line's normal from the robot's heading, left is positive
    length: NonNegative  # m, of the piece that was seen


class LineReadings(Message, frozen=True, kw_only=True):
    """Lines extracted from one scan, all taken at the message's stamp."""

    schema_name = "dynpf.LineReadings"
    readings: Annotated[tuple[LineReading, ...], Meta(max_length=256)]


class PositionFix(Message, frozen=True, kw_only=True):
    """A measured position in the map, such as a satellite receiver's or a tracker's."""

    schema_name = "dynpf.PositionFix"
    x: float  # m
    y: float  # m


class CapsuleReading(Message, frozen=True, kw_only=True):
    """What a capsule in a tube reads where a motion has brought it."""

    schema_name = "dynpf.CapsuleReading"
    reading: Count  # its number: 0 at the start, then one for each motion
    ranges_px: Annotated[
        tuple[NonNegative, ...], Meta(min_length=5, max_length=5)
    ]  # px, at -60, -30, 0, 30, 60 degrees
    move: CapsuleMove | UnsetType = UNSET  # that it was told to make since the reading before; left out at the start


class Gripper(Message, frozen=True, kw_only=True):
    """The gripper's own sensing: contact switch and angle encoder (rad, from the x axis of the workspace)."""

    schema_name = "dynpf.Gripper"
    contact: bool
    theta: Angle  # rad


# --- what is estimated and commanded -------------------------------------------------------------------------------


class PartEstimate(Part, frozen=True, kw_only=True):
    x: float  # m
    y: float  # m
    variance: NonNegative  # of each coordinate, m^2
    seen: bool  # a detection was associated in this step


class HealthFigures(Part, frozen=True, kw_only=True):
    """The numbers behind a filter's health; one that is not known, or not finite, is left out."""

    position_sigma: float | UnsetType = UNSET  # m, along the direction where it is greatest
    heading_sigma: float | UnsetType = UNSET  # rad
    mode_mass: float | UnsetType = UNSET  # share of the weight in the heaviest mode
    n_eff_share: float | UnsetType = UNSET  # effective particles as a share of all
    log_likelihood: float | UnsetType = UNSET  # of one reading, natural logarithm, short-term average
    likelihood_ratio: float | UnsetType = UNSET  # short-term over long-term average
    refused_share: float | UnsetType = UNSET  # of the readings, lately
    impossible: Count = 0  # updates in a row that no particle explains


class FilterHealth(Part, frozen=True, kw_only=True):
    """How far an estimate can be relied on, and why."""

    status: Literal["tracking", "uncertain", "lost", "kidnapped", "map_does_not_fit"]
    reason: str
    figures: HealthFigures


class Estimate(Message, frozen=True, kw_only=True):
    """The pose estimate: weighted mean with circular heading, covariance of (x, y, theta) row by row, and health."""

    schema_name = "dynpf.Estimate"
    x: float  # m
    y: float  # m
    theta: Angle  # rad
    covariance: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]  # m^2, m rad, rad^2
    n_eff: NonNegative  # effective sample size
    parts: Annotated[tuple[PartEstimate, ...], Meta(max_length=64)] = ()
    held: Annotated[int, Meta(ge=-1, lt=64)] = -1  # index of the part in the gripper, or -1
    health: FilterHealth | UnsetType = UNSET  # left out by an estimator that does not judge itself


class MapProbability(Part, frozen=True, kw_only=True):
    map: str  # its name, or "none of these"
    probability: Annotated[float, Meta(ge=0.0, le=1.0)]


class MovedWall(Part, frozen=True, kw_only=True):
    """A place on the wall of the reference map that has moved, and how far outwards."""

    x_px: float  # px
    y_px: float  # px
    moved_px: float  # px


class CapsuleEstimate(Message, frozen=True, kw_only=True):
    """Where the capsule is, and which map of its tube holds."""

    schema_name = "dynpf.CapsuleEstimate"
    reading: Count  # that it follows
    x_px: float  # px
    y_px: float  # px
    theta: Angle  # rad
    covariance: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]  # px^2, px rad, rad^2, row by row
    n_eff: NonNegative  # effective sample size
    map: str  # the likeliest; of a filter that estimates no map, the one that it was told of; of radii, the nearest
    maps: Annotated[tuple[MapProbability, ...], Meta(max_length=64)] = ()  # posterior; empty: no map is estimated
    changed_at: NonNegative | UnsetType = UNSET  # expected number of the reading from which on ``map`` holds
    reference: str | UnsetType = UNSET  # the map that ``walls`` have moved from
    walls: Annotated[tuple[MovedWall, ...], Meta(max_length=10_000)] = ()  # what explains "none of these"; else empty
    end_radius_px: NonNegative | UnsetType = UNSET  # px, from a filter that estimates it
    end_radius_sigma_px: NonNegative | UnsetType = UNSET  # px


class Command(Message, frozen=True, kw_only=True):
    """What the robot shall do until the next command: velocity in workspace axes, gripper turning rate, grip."""

    schema_name = "dynpf.Command"
    mode: Literal["idle", "mate", "move", "leave", "drive"]
    target: Annotated[int, Meta(ge=-1, lt=64)] = -1  # index of the part it is about, or -1
    vx: float = 0.0  # m/s
    vy: float = 0.0  # m/s
    w: float = 0.0  # rad/s
    grip: bool = False
    finished: bool = False


# --- what hosts say ------------------------------------------------------------------------------------------------


class HostEvent(Message, frozen=True, kw_only=True):
    """Something that happened to a node's inputs, told to the node as an input: a gap in a topic's sequence."""

    schema_name = "dynpf.HostEvent"
    kind: Literal["gap"]
    topic: str
    node: str  # the sender
    first: Count  # sequence number
    last: Count  # sequence number


class Gap(Message, frozen=True, kw_only=True):
    """Sequence numbers that the recorder never received."""

    schema_name = "dynpf.Gap"
    topic: str
    node: str  # the sender
    boot: str
    first: Count  # sequence number
    last: Count  # sequence number


class Diagnostics(Message, frozen=True, kw_only=True):
    """Timings and counters of one process; wall-clock figures live here and nowhere else."""

    schema_name = "dynpf.Diagnostics"
    node: str
    steps: Count  # so far
    step_time_s: NonNegative  # s, spent in the node's own step since the last report
    refused: dict[str, Count]  # topic -> messages refused so far
    queue: Count  # messages waiting


def timestamp(stamp_ns: int) -> Timestamp:
    """Return a logical stamp in nanoseconds as Foxglove's seconds and nanoseconds."""
    return Timestamp(sec=stamp_ns // 10**9, nsec=stamp_ns % 10**9)


def planar_pose(x: float, y: float, theta: float) -> Pose:
    """Return a pose in the plane, heading ``theta`` in radians, as position and quaternion."""
    sine, cosine = sincos(theta / 2)
    return Pose(position=Vector3(x=x, y=y), orientation=Quaternion(z=sine, w=cosine))


def planar_poses(poses: NDArray[Any]) -> tuple[Pose, ...]:
    """Return many poses (3, N) as ``planar_pose`` returns one."""
    x, y, theta = np.asarray(poses, dtype=np.float64)
    sines, cosines = sincos(theta / 2)
    pose, vector, quaternion = Pose, Vector3, Quaternion
    return tuple(
        [
            pose(position=vector(x=east, y=north), orientation=quaternion(z=sine, w=cosine))
            for east, north, sine, cosine in zip(x.tolist(), y.tolist(), sines.tolist(), cosines.tolist(), strict=True)
        ]
    )


def heading(orientation: Quaternion) -> float:
    """Return the yaw in radians of a quaternion that turns about z alone."""
    return 2.0 * atan2(float(orientation.z), float(orientation.w))
