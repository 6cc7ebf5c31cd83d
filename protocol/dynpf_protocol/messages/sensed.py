"""Readings of a robot's sensors."""

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from dynpf_protocol.messages.base import Angle, Count, Message, NonNegative, Piece, Positive

__all__ = [
    "InitialPose",
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
    """The pose by odometry alone, in a frame of its own: only the motion from message to message has a meaning."""

    schema_name = "dynpf.OdometryPose"
    x: float  # m
    y: float  # m
    theta: Angle  # rad


class LandmarkReading(Piece, frozen=True, kw_only=True):
    """Range and bearing to one landmark."""

    landmark: Count  # its number
    range: NonNegative  # m
    bearing: Angle  # rad, from the robot's heading, left is positive
    x: float | UnsetType = UNSET  # m, position of a moving landmark at that time; left out for those on the map
    y: float | UnsetType = UNSET  # m


class LandmarkReadings(Message, frozen=True, kw_only=True):
    """Range and bearing to identified landmarks, all taken at the message's stamp."""

    schema_name = "dynpf.LandmarkReadings"
    readings: Annotated[tuple[LandmarkReading, ...], Meta(max_length=256)]


class InitialPose(Message, frozen=True, kw_only=True):
    """The robot's pose in the map, with covariance, as somebody says who knows: a filter begins anew there."""

    schema_name = "dynpf.InitialPose"
    x: float  # m
    y: float  # m
    theta: Angle  # rad
    covariance: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9)]  # of (x, y, theta) row by row


class Scanner(Message, frozen=True, kw_only=True):
    """The least and greatest range of a scanner; sent before its first scan, and whenever they change."""

    schema_name = "dynpf.Scanner"
    range_min: NonNegative = 0.0  # m; smaller ranges are invalid
    range_max: Positive  # m; also the reading of a beam without return


class LineReading(Piece, frozen=True, kw_only=True):
    """A straight piece of wall in polar form: the distance of the line, and the direction of its normal."""

    rho: NonNegative  # m, from the robot to the line
    alpha: Angle  # rad, of the line's normal from the robot's heading, left is positive
    length: NonNegative  # m, of the observed piece


class LineReadings(Message, frozen=True, kw_only=True):
    """Lines extracted from one scan, at the message's stamp."""

    schema_name = "dynpf.LineReadings"
    readings: Annotated[tuple[LineReading, ...], Meta(max_length=256)]


class PositionFix(Message, frozen=True, kw_only=True):
    """A measured position in the map, such as a satellite receiver's or a tracker's."""

    schema_name = "dynpf.PositionFix"
    x: float  # m
    y: float  # m
