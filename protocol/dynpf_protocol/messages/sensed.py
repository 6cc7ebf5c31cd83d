"""What a robot senses."""

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from dynpf_protocol.messages.base import Angle, Message, NonNegative, Piece, Positive

__all__ = [
    "LandmarkReading",
    "LandmarkReadings",
    "LineReading",
    "LineReadings",
    "Odometry",
    "OdometryPose",
    "PositionFix",
    "Scanner",
]


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


class LandmarkReading(Piece, frozen=True, kw_only=True):
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


class LineReading(Piece, frozen=True, kw_only=True):
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
