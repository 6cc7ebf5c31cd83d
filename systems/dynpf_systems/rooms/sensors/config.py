"""Configuration of the sensors process: which sensors there are and how well they see; SI units and radians."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from dynpf.motion.gyro import GyroOdometryParams

__all__ = [
    "GripperSensor",
    "GyroSensor",
    "LandmarkSensor",
    "LineSensor",
    "LogSensorsConfig",
    "OdometrySensor",
    "OverheadSensor",
    "PositionSensor",
    "ScanSensor",
    "SimulatedSensorsConfig",
]

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
FieldOfView = Annotated[float, Meta(gt=0.0, le=math.tau)]
Every = Annotated[int, Meta(ge=1)]


class GyroSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A rate gyro, and the extended Kalman filter that corrects the wheels' turning rate by it."""

    w_std: NonNegative = 0.005  # rad/s
    w_bias: float = 0.0  # rad/s
    filter: GyroOdometryParams = GyroOdometryParams()


class OdometrySensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Wheel encoders: Gaussian noise of standard deviation sqrt(std^2 + (std_per_unit * true)^2), and a bias."""

    v_std: NonNegative = 0.0  # m/s
    v_std_per_unit: NonNegative = 0.0  # of the true speed
    v_bias: float = 0.0  # m/s
    w_std: NonNegative = 0.0  # rad/s
    w_std_per_unit: NonNegative = 0.0  # of the true turning rate
    w_bias: float = 0.0  # rad/s
    w_scale: Positive = (
        1.0  # of the true turning rate: wheels farther apart or closer together than they are taken to be
    )
    gyro: GyroSensor | None = None  # absent: the wheels alone
    every: Every = 1  # ticks between readings


class GripperSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contact switch and angle encoder of the gripper."""

    tolerance: NonNegative = 0.002  # m beyond the gripper's reach at which the switch still closes
    theta_std: NonNegative = 0.0  # rad
    every: Every = 1


class LandmarkSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Range and bearing to identified landmarks; range noise sqrt(range_std^2 + (range_std_per_metre * range)^2)."""

    max_range: Positive = 5.0  # m
    field_of_view: FieldOfView = math.tau  # rad, centred on the heading
    range_std: NonNegative = 0.02  # m
    range_std_per_metre: NonNegative = 0.0
    bearing_std: NonNegative = 0.01  # rad
    misread_probability: Probability = 0.0  # a reading carries another landmark's number
    every: Every = 1


class ScanSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Ranges from the robot's centre to walls, parts, people and closed doors, on beams spread over the field of view.

    The walls are those given here, else the map's, else the rectangle of the task's workspace. The noise's standard
    deviation is range_std + range_std_per_square_metre range^2: that of a structured-light camera grows so.
    """

    beams: Annotated[int, Meta(ge=2, le=100_000)] = 60
    field_of_view: FieldOfView = 3 * math.pi / 2  # rad, first to last beam, centred on the heading
    range_min: NonNegative = 0.0  # m; what is nearer gives no reading, which is 0
    range_max: Positive = 4.0  # m; also the reading of a beam without return
    range_std: NonNegative = 0.01  # m
    range_std_per_square_metre: NonNegative = 0.0  # 1/m
    glass: tuple[tuple[float, float, float, float], ...] = ()  # walls of the map, as it has them, that beams go through
    walls: tuple[tuple[float, float, float, float], ...] = ()  # x1, y1, x2, y2 in m
    every: Every = 1


class LineSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What line extraction makes of the walls in view: the parts of the map's segments that nothing hides.

    As in a scan, beams find them; a part that fewer than ``min_beams`` meet is not found.
    """

    beams: Annotated[int, Meta(ge=2, le=100_000)] = 181
    min_beams: Annotated[int, Meta(ge=2)] = 5
    field_of_view: FieldOfView = math.pi  # rad, first to last beam, centred on the heading
    max_range: Positive = 4.0  # m
    min_length: NonNegative = 0.2  # m; a shorter part is not found
    rho_std: NonNegative = 0.02  # m, of the line's distance
    alpha_std: NonNegative = 0.01  # rad, of its direction
    every: Every = 1


class PositionSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The robot's position in the map, with the same Gaussian noise on both coordinates."""

    std: NonNegative = 0.1  # m
    every: Every = 1


class OverheadSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An overhead tracker of robot and parts, for runs without camera frames.

    The robot is told from the parts as in the camera's frames: darker than the background, the parts brighter.
    """

    variance: NonNegative | None = None  # m^2, of each coordinate; absent: that of the task's noise
    radius_std: NonNegative = 0.0  # m
    miss_probability: Probability = 0.0  # of each disc in each frame
    clutter_rate: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0  # mean number of false discs a frame
    robot_grey: float = -60.0  # grey levels less the background's
    part_grey: float = 60.0
    every: Every = 1


class SimulatedSensorsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="simulated"
):
    """Sensors that read the simulator's true state; a sensor that is left out is not there."""

    odometry: OdometrySensor | None = None
    gripper: GripperSensor | None = None
    landmarks: LandmarkSensor | None = None
    scan: ScanSensor | None = None
    lines: LineSensor | None = None
    position: PositionSensor | None = None
    overhead: OverheadSensor | None = None


class LogSensorsConfig(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="log"
):
    """Sensors that hand on the records of an imported log."""
