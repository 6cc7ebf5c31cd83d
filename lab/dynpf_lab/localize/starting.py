"""Where a robot may start in a map, and whether poses are in the frame of the map: judged by its first scans."""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from dynpf_formats.regular_files import read_regular
from dynpf_protocol.codec import decode
from dynpf_protocol.errors import UsageError
from dynpf_protocol.json_text import read_json
from dynpf_protocol.messages import LaserScan, OdometryPose, RobotState, Scanner
from dynpf_runtime.source import LogRecord
from dynpf_systems.rooms.fit import TimedScan, poses_at
from dynpf_systems.rooms.localization.readings import reading_of
from dynpf_systems.rooms.wall_fit import WallFit

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.scan import Scan
from dynpf.metrics.trajectory import Trajectory
from dynpf.se2 import compose, relative

__all__ = [
    "LastPose",
    "Start",
    "digest_of",
    "first_fit",
    "fits",
    "path_in",
    "read_last",
    "scans_in",
]

BETTER_THAN_CHANCE = 0.15
"""By how much more of the beams must end near walls at poses of the map's frame than anywhere on the map."""

LEAST_FIT = 0.4
FIRST_SCANS = 5
LONGEST = 2**16


class Start(NamedTuple):
    """Where a run begins: a pose (m, m, rad) with its standard deviations, or a search of the map; and why."""

    why: str
    pose: tuple[float, float, float] | None = None
    sigma_m: float = 0.2
    sigma_rad: float = 0.1


class LastPose(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a robot was last, in the map of the given digest."""

    x: float  # m
    y: float  # m
    theta: float  # rad
    map_sha256: str
    recording: str
    stamp_ns: int


def scans_in(records: Sequence[LogRecord], most: int) -> list[TimedScan]:
    """Return at most ``most`` of a log's scans, evenly spaced, each as its scanner has announced it."""
    count = sum(record.topic == "log/scan" for record in records)
    wanted = {int(index) for index in np.linspace(0, count - 1, min(most, count))} if count else set()
    found, number, announced = [], 0, None
    for record in records:
        if record.topic == "log/scanner":
            announced = decode(record.topic, record.payload)
        elif record.topic == "log/scan":
            if number in wanted and isinstance(announced, Scanner):
                message = decode(record.topic, record.payload)
                assert isinstance(message, LaserScan)
                found.append(TimedScan(record.stamp_ns * 1e-9, reading_of(message, Scan, announced)))
            number += 1
    return found


def path_in(records: Sequence[LogRecord], topic: str) -> Trajectory:
    """Return the poses of a log's topic, in order of time."""
    poses: list[tuple[int, float, float, float]] = []
    for record in records:
        if record.topic == topic:
            pose = decode(record.topic, record.payload)
            assert isinstance(pose, OdometryPose | RobotState)
            poses.append((record.stamp_ns, pose.x, pose.y, pose.theta))
    rows = np.array(sorted(poses), dtype=np.float64).reshape(-1, 4)
    return Trajectory(rows[:, 0] * 1e-9, rows[:, 1:].T)


def fits(share: float, chance: float) -> bool:
    """Return whether so many beams end near walls that the poses must be in the map's frame."""
    return share >= LEAST_FIT and share >= chance + BETTER_THAN_CHANCE


def first_fit(records: Sequence[LogRecord], walls: WallFit, pose: Sequence[float]) -> float:
    """Return the share of the first scans' beams that end near walls for a robot that was at ``pose`` at the start."""
    scans = _first_scans(records)
    odometry = path_in(records, "log/odometry_pose")
    poses, inside = poses_at(odometry, np.array([scan.stamp for scan in scans]))
    if not inside.size:
        return walls.share([scan.scan for scan in scans[:1]], np.array(pose)[:, None])
    moved = np.stack([compose(np.array(pose), relative(odometry.poses[:, 0], there)) for there in poses.T], axis=1)
    return walls.share([scans[index].scan for index in inside], moved)


def _first_scans(records: Sequence[LogRecord]) -> list[TimedScan]:
    last = count = 0
    for index, record in enumerate(records):
        count += record.topic == "log/scan"
        last = index + 1
        if count == FIRST_SCANS:
            break
    return scans_in(records[:last], FIRST_SCANS)


def digest_of(grid: OccupancyGrid) -> str:
    """Return a digest of a map's cells and their place."""
    place = repr((grid.resolution, grid.origin, grid.cells.shape)).encode()
    return hashlib.sha256(place + grid.cells.tobytes()).hexdigest()


def read_last(path: Path, grid: OccupancyGrid) -> LastPose:
    """Return the last pose that a run has left in a file; raises UsageError if there is none, or of another map."""
    try:
        last = read_json(read_regular(path, LONGEST), LastPose)
    except FileNotFoundError as error:
        raise UsageError(f"--start last: {path} is not there: no run has left its last pose here yet") from error
    except OSError as error:
        raise UsageError(f"--start last: {path}: cannot be read: {error.strerror or error}") from error
    except msgspec.DecodeError as error:
        raise UsageError(f"--start last: {path}: holds no pose: {error}") from error
    if not all(map(math.isfinite, (last.x, last.y, last.theta))):
        raise UsageError(f"--start last: {path}: the pose is not finite")
    if last.map_sha256 != digest_of(grid):
        raise UsageError(f"--start last: {path} is a pose in another map, of {last.recording}")
    return last
