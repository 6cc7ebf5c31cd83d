"""What estimators of all kinds say besides the estimate: the robot's frame, the particles, which inputs never came."""

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

__all__ = ["GAPS", "gap_warning", "particles_picture", "robot_transform"]

GAPS = "event/estimator"
"""Where the host tells of gaps in what the estimator consumes."""


def gap_warning(gap: HostEvent, stamp_ns: int, name: str) -> Output:
    """Return the warning of the node ``name``, for the log, that messages of a topic are missing or late."""
    which = f"message {gap.first}" if gap.first == gap.last else f"messages {gap.first} to {gap.last}"
    text = f"{gap.topic} of {gap.node}: {which} did not come in time; the estimate goes on without"
    return Output("log", Log(timestamp=timestamp(stamp_ns), level=LogLevel.WARNING, message=text, name=name))


def robot_transform(x: float, y: float, theta: float, now: Timestamp) -> FrameTransforms:
    """Return the place of the robot's frame in the map: metres and radians."""
    pose = planar_pose(x, y, theta)
    placed = FrameTransform(
        timestamp=now,
        parent_frame_id=frames.MAP,
        child_frame_id=frames.ROBOT,
        translation=pose.position,
        rotation=pose.orientation,
    )
    return FrameTransforms(transforms=(placed,))


def particles_picture(particles: NDArray[Any], now: Timestamp) -> PosesInFrame:
    """Return particles (3, N), at most 200, as they are shown: metres and radians, to 1 mm and 1 mrad.

    Particles are most of a recording, of which this leaves a third. Quaternions have four decimals, which turn a
    heading by less than 0.15 mrad. Zeros are written, too: to a viewer a number that is absent is none.
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


def _rounded(values: NDArray[np.float64], parts: float) -> NDArray[np.float64]:
    """Return values as the nearest whole numbers of parts of one, halves to the even one, and no zero below zero."""
    found: NDArray[np.float64] = np.rint(values * parts) / parts + 0.0
    return found
