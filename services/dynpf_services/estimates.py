"""What estimators of all kinds say besides the estimate: where the robot's frame is, and which inputs never came."""

from dynpf_protocol import frames
from dynpf_protocol.messages import (
    FrameTransform,
    FrameTransforms,
    HostEvent,
    Log,
    LogLevel,
    Timestamp,
    planar_pose,
    timestamp,
)
from dynpf_runtime.node import Output

__all__ = ["GAPS", "gap_warning", "robot_transform"]

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
