"""Messages of all estimators besides the estimate: the robot's frame, the particles, warnings of missing inputs."""

from typing import Any

import numpy as np
from dynpf_protocol import frames
from dynpf_protocol.messages import (
    FrameTransform,
    FrameTransforms,
    HostEvent,
    Log,
    LogLevel,
    Pose,
    PosesInFrame,
    Quaternion,
    Timestamp,
    Vector3,
    planar_pose,
    timestamp,
)
from dynpf_runtime.node import Output
from numpy.typing import NDArray

from dynpf.portable import sincos
from dynpf.types import FloatArray

__all__ = ["GAPS", "gap_warning", "particles_picture", "robot_transform", "warning"]

GAPS = "event/estimator"
"""The topic of the host's events about gaps in the estimator's inputs."""


def gap_warning(gap: HostEvent, stamp_ns: int, name: str) -> Output:
    """Return the warning of the node ``name`` for the topic ``log`` that messages are missing or late."""
    which = f"message {gap.first}" if gap.first == gap.last else f"messages {gap.first} to {gap.last}"
    return warning(
        f"{gap.topic} of {gap.node}: {which} did not come in time; the estimate goes on without", stamp_ns, name
    )


def warning(text: str, stamp_ns: int, name: str) -> Output:
    """Return a warning of the node ``name`` for the topic ``log``."""
    return Output("log", Log(timestamp=timestamp(stamp_ns), level=LogLevel.WARNING, message=text, name=name))


def robot_transform(x: float, y: float, theta: float, now: Timestamp) -> FrameTransforms:
    """Return the transform of the robot's frame in the map; metres and radians."""
    pose = planar_pose(x, y, theta)
    transform = FrameTransform(
        timestamp=now,
        parent_frame_id=frames.MAP,
        child_frame_id=frames.ROBOT,
        translation=pose.position,
        rotation=pose.orientation,
    )
    return FrameTransforms(transforms=(transform,))


def particles_picture(particles: NDArray[Any], now: Timestamp) -> PosesInFrame:
    """Return particles (3, N), at most 200, in metres and radians, rounded to 1 mm and 1 mrad for viewers.

    Particles are most of a recording; rounding shrinks them to a third. Quaternions have four decimals, which change a
    heading by less than 0.15 mrad. Zeros are written too, because viewers do not read an absent number as zero.
    """
    x, y, theta = _rounded(np.asarray(particles, dtype=np.float64), 1000.0)
    sines, cosines = (_rounded(part, 10_000.0) for part in sincos(theta / 2))
    pose, vector, quaternion = Pose, Vector3, Quaternion
    poses = tuple(
        [
            pose(position=vector(x=east, y=north), orientation=quaternion(z=sine, w=cosine))
            for east, north, sine, cosine in zip(x.tolist(), y.tolist(), sines.tolist(), cosines.tolist(), strict=True)
        ]
    )
    return PosesInFrame(timestamp=now, frame_id=frames.MAP, poses=poses)


def _rounded(values: FloatArray, parts: float) -> FloatArray:
    """Return values rounded to multiples of 1 / ``parts``, halves to even, without negative zeros."""
    found: FloatArray = np.rint(values * parts) / parts + 0.0
    return found
