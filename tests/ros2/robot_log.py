"""A robot's log as the other side is to publish it, and its map as a robot's map_server has it."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from dynpf_formats.importers.log import Record
from dynpf_formats.recording.header import Attachment
from dynpf_formats.ros2.types import RosTypes
from dynpf_protocol.messages import LaserScan, OdometryPose

from dynpf.maps.map_server import decode

__all__ = ["ODOMETRY", "SCAN", "room_of", "write_log"]

ODOMETRY, SCAN = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"
RANGE_MAX_M = 80.0
STAMP = {"sec": 0, "nanosec": 0}
NOWHERE = {"x": 0.0, "y": 0.0, "z": 0.0}
UNTURNED = {**NOWHERE, "w": 1.0}


def write_log(records: Iterable[Record], path: Path, seconds: float) -> dict[str, int]:
    """Write scans and odometry as lines of other_side.play; return how many there are by topic."""
    counts = {"/scan": 0, "/odom": 0}
    began: int | None = None
    with path.open("w") as lines:
        for record in records:
            began = record.stamp_ns if began is None else began
            at_s = (record.stamp_ns - began) * 1e-9
            if at_s > seconds:
                break
            if isinstance(record.message, LaserScan):
                topic, told = "/scan", _scan(record.message)
            elif isinstance(record.message, OdometryPose):
                topic, told = "/odom", _odometry(record.message)
            else:
                continue
            counts[topic] += 1
            print(json.dumps([at_s, topic, told]), file=lines)
    return counts


def _scan(scan: LaserScan) -> dict[str, Any]:
    step = (scan.end_angle - scan.start_angle) / (len(scan.ranges) - 1)
    return {
        "header": {"stamp": STAMP, "frame_id": "base"},
        "angle_min": scan.start_angle,
        "angle_max": scan.end_angle,
        "angle_increment": step,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": 0.0,
        "range_max": RANGE_MAX_M,
        "ranges": [math.inf if distance >= RANGE_MAX_M else distance for distance in scan.ranges],
        "intensities": [],
    }


def _odometry(pose: OdometryPose) -> dict[str, Any]:
    turned = {"x": 0.0, "y": 0.0, "z": math.sin(pose.theta / 2), "w": math.cos(pose.theta / 2)}
    place = {"position": {"x": pose.x, "y": pose.y, "z": 0.0}, "orientation": turned}
    return {
        "header": {"stamp": STAMP, "frame_id": "odom"},
        "child_frame_id": "base",
        "pose": {"pose": place, "covariance": [0.0] * 36},
        "twist": {"twist": {"linear": NOWHERE, "angular": NOWHERE}, "covariance": [0.0] * 36},
    }


def room_of(attachments: Iterable[Attachment], types: RosTypes) -> bytes:
    """Return the OccupancyGrid of a map that was attached to a log."""
    files = {Path(one.name).name: one.data for one in attachments}
    name = next(name for name in files if name.endswith(".yaml"))
    grid = decode(files[name].decode(), files.__getitem__, name)
    assert grid.origin[2] == 0.0
    cells = np.where(grid.occupied, 100, np.where(grid.free, 0, -1)).astype(np.int8)
    make = types.make
    stamp = make("builtin_interfaces/msg/Time", 0, 0)
    position = make("geometry_msgs/msg/Point", grid.origin[0], grid.origin[1], 0.0)
    origin = make("geometry_msgs/msg/Pose", position, make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    height, width = cells.shape
    info = make("nav_msgs/msg/MapMetaData", stamp, grid.resolution, width, height, origin)
    kind = "nav_msgs/msg/OccupancyGrid"
    return types.encode(kind, make(kind, make("std_msgs/msg/Header", stamp, "map"), info, cells.reshape(-1)))
