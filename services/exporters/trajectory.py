"""Trajectories in the format of the TUM RGB-D benchmark, as evo reads them: time, position and quaternion a line."""

import math
from collections.abc import Iterator

from protocol.codec import decode
from protocol.messages import Estimate, Message, OdometryPose, Pose, PoseInFrame, RobotState, planar_pose
from protocol.topics import TOPICS
from services.recording.reader import Recording

__all__ = ["POSE_TOPICS", "tum_lines"]

_KINDS = (Estimate, OdometryPose, PoseInFrame, RobotState)

POSE_TOPICS = tuple(name for name, row in TOPICS.items() if row.type in _KINDS)
"""The topics whose messages are poses."""


def tum_lines(recording: Recording, topic: str) -> Iterator[str]:
    """Yield the poses of a topic in order of time; of several at one time, the last.

    Times have all their nanoseconds, numbers all their digits. ``topic`` is one of POSE_TOPICS.
    """
    newest = {one.stamp_ns: one for one in recording.messages(topic)}
    for stamp_ns in sorted(newest):
        pose = _pose(decode(topic, newest[stamp_ns].payload))
        at, q = pose.position, pose.orientation
        numbers = " ".join(map(repr, (at.x, at.y, at.z, q.x, q.y, q.z, q.w)))
        yield f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {numbers}"


def _pose(message: Message) -> Pose:
    match message:
        case PoseInFrame(pose=pose):
            return pose
        case Estimate(x=x, y=y, theta=theta) | OdometryPose(x=x, y=y, theta=theta) | RobotState(x=x, y=y, theta=theta):
            return planar_pose(x, y, math.remainder(theta, math.tau))
    raise TypeError(f"{type(message).__name__} is no pose")
