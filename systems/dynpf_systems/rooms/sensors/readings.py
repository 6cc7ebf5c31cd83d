"""What each simulated sensor reads in a given true state: one pure function a sensor, its random stream an argument."""

import math
from collections.abc import Callable

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    LandmarkReading,
    LandmarkReadings,
    LaserScan,
    LineReading,
    LineReadings,
    Odometry,
    PositionFix,
    RobotState,
    planar_pose,
    timestamp,
)
from numpy.typing import NDArray

from dynpf.measurement.ray import ray_discs, ray_segments
from dynpf.portable import atan2, hypot, sincos
from dynpf.rng import Draws
from dynpf_systems.parts.messages import Detection, Detections, Gripper, PartsState
from dynpf_systems.parts.task import NOISE, RearrangementTask
from dynpf_systems.rooms.messages import Obstacles
from dynpf_systems.rooms.sensors.config import (
    GripperSensor,
    GyroSensor,
    LandmarkSensor,
    LineSensor,
    OdometrySensor,
    OverheadSensor,
    PositionSensor,
    ScanSensor,
)

__all__ = [
    "Floats",
    "Rays",
    "read_gripper",
    "read_gyro",
    "read_landmarks",
    "read_lines",
    "read_odometry",
    "read_overhead",
    "read_position",
    "read_scan",
    "rectangle",
]

Floats = NDArray[np.float64]
Rays = Callable[[Floats, Floats], Floats]
"""Distances (B,) from an origin (2,) along angles (B,) of the map frame to the nearest wall, infinite without one."""


def read_odometry(sensor: OdometrySensor, robot: RobotState, rng: Draws) -> Odometry:
    noise_v, noise_w = rng.standard_normal(2).tolist()
    return Odometry(
        v=robot.v + sensor.v_bias + hypot(sensor.v_std, sensor.v_std_per_unit * robot.v) * noise_v,
        w=sensor.w_scale * robot.w + sensor.w_bias + hypot(sensor.w_std, sensor.w_std_per_unit * robot.w) * noise_w,
    )


def read_gyro(sensor: GyroSensor, robot: RobotState, rng: Draws) -> float:
    return robot.w + sensor.w_bias + sensor.w_std * float(rng.standard_normal())


def read_gripper(
    sensor: GripperSensor, robot: RobotState, parts: PartsState, task: RearrangementTask, rng: Draws
) -> Gripper:
    """The switch is closed while a part is held, or while one is no farther from the robot's rim than the gripper."""
    within = task.robot_radius + task.reach + sensor.tolerance
    touching = any(hypot(part.x - robot.x, part.y - robot.y) - part.radius <= within for part in parts.parts)
    theta = robot.theta + sensor.theta_std * float(rng.standard_normal())
    return Gripper(contact=parts.held >= 0 or touching, theta=math.remainder(theta, math.tau))


def read_landmarks(
    sensor: LandmarkSensor, robot: RobotState, landmarks: tuple[Landmark, ...], rng: Draws
) -> LandmarkReadings:
    """Every landmark takes its own draws, so that one that comes into view changes no other's reading."""
    noise = rng.standard_normal((len(landmarks), 2)).tolist()
    misread = (rng.random(len(landmarks)) < sensor.misread_probability).tolist()
    swap = rng.integers(1, max(len(landmarks), 2), size=len(landmarks)).tolist()
    readings = []
    for index, landmark in enumerate(landmarks):
        distance = hypot(landmark.x - robot.x, landmark.y - robot.y)
        bearing = math.remainder(atan2(landmark.y - robot.y, landmark.x - robot.x) - robot.theta, math.tau)
        if distance > sensor.max_range or abs(bearing) > sensor.field_of_view / 2:
            continue
        std = hypot(sensor.range_std, sensor.range_std_per_metre * distance)
        seen_as = landmarks[(index + swap[index]) % len(landmarks)] if misread[index] else landmark
        readings.append(
            LandmarkReading(
                landmark=seen_as.id,
                range=max(0.0, distance + std * noise[index][0]),
                bearing=math.remainder(bearing + sensor.bearing_std * noise[index][1], math.tau),
            )
        )
    return LandmarkReadings(readings=tuple(readings))


def read_scan(
    sensor: ScanSensor,
    robot: RobotState,
    parts: PartsState | None,
    obstacles: Obstacles | None,
    walls: Rays,
    *,
    stamp_ns: int,
    rng: Draws,
) -> LaserScan:
    """A beam that meets nothing within range_max reads range_max, without noise; one that meets too near a thing, 0."""
    half = sensor.field_of_view / 2
    angles = robot.theta + np.linspace(-half, half, sensor.beams)
    origin = np.array([robot.x, robot.y])
    ranges = walls(origin, angles)
    if parts is not None and parts.parts:
        discs = np.array([(part.x, part.y, part.radius) for part in parts.parts])
        ranges = np.minimum(ranges, ray_discs(origin, angles, discs))
    if obstacles is not None:
        people = np.array([(one.x, one.y, one.radius) for one in obstacles.people]).reshape(-1, 3)
        doors = np.array([(one.x1, one.y1, one.x2, one.y2) for one in obstacles.doors]).reshape(-1, 4)
        ranges = np.minimum(ranges, np.minimum(ray_discs(origin, angles, people), ray_segments(origin, angles, doors)))
    returned = ranges < sensor.range_max
    true = np.where(returned, ranges, sensor.range_max)
    std = sensor.range_std + sensor.range_std_per_square_metre * (true * true)
    read = np.clip(true + std * rng.standard_normal(sensor.beams), 0.0, sensor.range_max)
    ranges = np.where(returned, np.where(true < sensor.range_min, 0.0, read), sensor.range_max)
    return LaserScan(
        timestamp=timestamp(stamp_ns),
        frame_id=frames.ROBOT,
        pose=planar_pose(0.0, 0.0, 0.0),
        start_angle=-half,
        end_angle=half,
        ranges=tuple(ranges.tolist()),
    )


def read_lines(sensor: LineSensor, robot: RobotState, walls: Floats, rng: Draws) -> LineReadings:
    """``walls`` is (S, 4). Every wall takes its own draws; of one that something hides in part each part is a line."""
    noise = rng.standard_normal((len(walls), 2)) * (sensor.rho_std, sensor.alpha_std)
    half = sensor.field_of_view / 2
    angles = np.linspace(-half, half, sensor.beams)
    origin = np.array([robot.x, robot.y])
    ranges = np.stack([ray_segments(origin, robot.theta + angles, wall[None]) for wall in walls])
    nearest = np.argmin(ranges, axis=0)
    distance = ranges[nearest, np.arange(sensor.beams)]
    met = np.where(distance < sensor.max_range, nearest, -1)
    changes = np.flatnonzero(np.diff(met)) + 1
    readings = []
    for beams in np.split(np.arange(sensor.beams), changes):
        wall, first, last = int(met[beams[0]]), beams[0], beams[-1]
        if wall < 0 or len(beams) < sensor.min_beams:
            continue
        sine, cosine = sincos(angles[[first, last]])
        ends = distance[[first, last]] * np.array([cosine, sine])
        (dx, dy), (x, y) = ends[:, 1] - ends[:, 0], ends[:, 0]
        length = hypot(dx, dy)
        if length < max(sensor.min_length, 1e-9):
            continue
        rho = (x * dy - y * dx) / length + noise[wall, 0]
        alpha = atan2(-dx, dy) + noise[wall, 1]
        if rho < 0.0:
            rho, alpha = -rho, alpha + math.pi
        readings.append(LineReading(rho=float(rho), alpha=math.remainder(alpha, math.tau), length=length))
    return LineReadings(readings=tuple(readings[:256]))


def read_position(sensor: PositionSensor, robot: RobotState, rng: Draws) -> PositionFix:
    noise_x, noise_y = (sensor.std * rng.standard_normal(2)).tolist()
    return PositionFix(x=robot.x + noise_x, y=robot.y + noise_y)


def read_overhead(
    sensor: OverheadSensor, robot: RobotState, parts: PartsState, task: RearrangementTask, rng: Draws
) -> Detections:
    """Return noisy discs in random order, as a tracker without identities would; hidden parts are not among them."""
    true = [(robot.x, robot.y, task.robot_radius, sensor.robot_grey)]
    true += [(part.x, part.y, part.radius, sensor.part_grey) for part in parts.parts]
    missed = rng.random(len(true)) < sensor.miss_probability
    missed[[part + 1 for part in parts.hidden]] = True
    noise = rng.standard_normal((len(true), 3)).tolist()
    std = math.sqrt(NOISE[task.noise].measurement if sensor.variance is None else sensor.variance)
    discs = [
        Detection(
            x=x + std * dx,
            y=y + std * dy,
            radius=max(radius + sensor.radius_std * dr, radius / 10),  # stays a disc however wide the noise
            grey=grey,
        )
        for (x, y, radius, grey), (dx, dy, dr), miss in zip(true, noise, missed.tolist(), strict=True)
        if not miss
    ]
    discs += _clutter(sensor, true, task, rng)
    order = rng.permutation(len(discs)).tolist()
    return Detections(discs=tuple(discs[index] for index in order))


def _clutter(
    sensor: OverheadSensor,
    true: list[tuple[float, float, float, float]],
    task: RearrangementTask,
    rng: Draws,
) -> list[Detection]:
    """Return false discs anywhere in the workspace, of the sizes and greys that are there."""
    count = min(rng.poisson(sensor.clutter_rate), 256 - len(true))
    x = rng.uniform(-task.width / 2, task.width / 2, count).tolist()
    y = rng.uniform(-task.height / 2, task.height / 2, count).tolist()
    like = rng.integers(0, len(true), count).tolist()
    return [Detection(x=x[i], y=y[i], radius=true[like[i]][2], grey=true[like[i]][3]) for i in range(count)]


def rectangle(width: float, height: float) -> Floats:
    """Return the four walls (4, 4) of a rectangle centred at the origin, as x1, y1, x2, y2; metres."""
    x, y = width / 2, height / 2
    return np.array([(-x, -y, x, -y), (x, -y, x, y), (x, y, -x, y), (-x, y, -x, -y)])
