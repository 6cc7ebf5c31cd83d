"""Point clouds of depth cameras flattened to range scans, as TURTLEBOT does (pointcloud_to_laserscan).

Each beam of the scan takes the nearest point in its direction, out of those in a band of heights.
"""

import math
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from dynpf.portable import atan2, hypot, product, whole
from dynpf.types import FloatArray, NonNegative, Positive

__all__ = ["FlattenParams", "flatten", "points_of"]

DTYPES = {7: "f4", 8: "f8"}  # of sensor_msgs/PointField


class FlattenParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The scan that a cloud is flattened to; the defaults are a Kinect's (TURTLEBOT)."""

    field_of_view: Annotated[float, Meta(gt=0.0, le=2 * math.pi)] = math.radians(57.8)  # rad, first to last beam
    beams: Annotated[int, Meta(ge=2, le=100_000)] = 116
    range_min: NonNegative = 0.6  # m
    range_max: Positive = 4.0  # m; also the reading of a beam without a point
    low: float = 0.05  # m, above the robot's base
    high: float = 1.0  # m, above the robot's base


def points_of(message: Any) -> FloatArray:
    """Return the finite points of a PointCloud2, shape (N, 3), in metres in the cloud's own frame.

    Raises ValueError if the message's data do not fit its fields.
    """
    fields = {field.name: field for field in message.fields}
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise ValueError(f"no field {missing[0]}")
    order = ">" if message.is_bigendian else "<"
    width, height, step, row = (int(n) for n in (message.width, message.height, message.point_step, message.row_step))
    offsets = [int(fields[name].offset) for name in "xyz"]
    try:
        formats = [order + DTYPES[int(fields[name].datatype)] for name in "xyz"]
    except KeyError as kind:
        raise ValueError(f"coordinates of type {kind}; expected 32 or 64-bit floats") from None
    if step < max(offset + int(kind[-1]) for offset, kind in zip(offsets, formats, strict=True)) or row < width * step:
        raise ValueError(f"points of {step} bytes in rows of {row}")
    if len(message.data) < height * row:
        raise ValueError(f"{len(message.data)} bytes for {height} rows of {row}")
    if width * height == 0:
        return np.empty((0, 3))
    dtype = np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step})
    data = np.frombuffer(memoryview(message.data), np.uint8, height * row).reshape(height, row)[:, : width * step]
    points = np.ascontiguousarray(data).reshape(-1).view(dtype)
    found = np.stack([points[name].astype(np.float64) for name in "xyz"], axis=1)
    return found[np.isfinite(found).all(axis=1)]


def flatten(
    points: FloatArray, transform: FloatArray, sensor: tuple[float, float, float], params: FlattenParams
) -> FloatArray:
    """Return the ranges (B,) in metres of a cloud's scan, range_max for a beam without a point.

    ``points`` (N, 3) are in the cloud's frame, ``transform`` (4, 4) is that frame's pose on the robot; ``sensor`` is
    the pose of the scan on the robot (m, m, rad).
    """
    seen = product(points, transform[:3, :3].T) + transform[:3, 3]
    seen = seen[np.isfinite(seen).all(axis=1) & (seen[:, 2] >= params.low) & (seen[:, 2] <= params.high)]
    dx, dy = seen[:, 0] - sensor[0], seen[:, 1] - sensor[1]
    distance = hypot(dx, dy)
    bearing = np.mod(atan2(dy, dx) - sensor[2] + np.pi, 2 * np.pi) - np.pi
    step = params.field_of_view / (params.beams - 1)
    beam = whole(np.rint((bearing + params.field_of_view / 2) / step), -1, params.beams)
    kept = (beam >= 0) & (beam < params.beams) & (distance >= params.range_min) & (distance <= params.range_max)
    ranges = np.full(params.beams, params.range_max)
    np.minimum.at(ranges, beam[kept], distance[kept])
    return ranges
