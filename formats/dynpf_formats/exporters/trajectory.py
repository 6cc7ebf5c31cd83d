"""Trajectories in the format of the TUM RGB-D benchmark, as evo reads them: time, position and quaternion per line."""

import math
from collections.abc import Iterator

from dynpf_protocol.codec import decode
from dynpf_protocol.messages import Estimate, Message, OdometryPose, Pose, PoseInFrame, RobotState, planar_pose

from dynpf_formats.recording.reader import Recorded, Recording

__all__ = ["pose_topics", "tum_lines"]

REFERENCE = "log/truth"
_KINDS = (Estimate, OdometryPose, PoseInFrame, RobotState)


def pose_topics(recording: Recording) -> list[str]:
    """Return the topics of a recording whose messages are poses."""
    return sorted(name for name, row in recording.topics.items() if row.type in _KINDS and name in recording.schemas)


def tum_lines(recording: Recording, topic: str) -> Iterator[str]:
    """Yield the poses of a topic in order of time; of several with one stamp the last, or the scored one.

    A log whose clock jumps back has records with the same stamp at different moments. If the reference has a pose with
    that stamp, the first pose that follows it in the file is taken, so that poses and reference pair up by stamp. Times
    have all their nanoseconds, numbers all their digits. ``topic`` is one of ``pose_topics``.
    """
    chosen = _unique_by_stamp(recording, topic)
    for stamp_ns in sorted(chosen):
        pose = _pose(decode(topic, chosen[stamp_ns].payload, recording.topics))
        at, q = pose.position, pose.orientation
        numbers = " ".join(map(repr, (at.x, at.y, at.z, q.x, q.y, q.z, q.w)))
        yield f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {numbers}"


def _unique_by_stamp(recording: Recording, topic: str) -> dict[int, Recorded]:
    chosen: dict[int, Recorded] = {}
    answered: set[int] = set()
    due_ns: int | None = None
    robot = topic.split("/")[:-2]  # its namespace; the topics of a robot without one have two words
    reference = "/".join([*robot, REFERENCE])
    for record in recording.messages():
        if record.topic == reference != topic:
            due_ns = record.stamp_ns
        elif record.topic == topic and record.stamp_ns not in answered:
            chosen[record.stamp_ns] = record
            if record.stamp_ns == due_ns:
                answered.add(due_ns)
    return chosen


def _pose(message: Message) -> Pose:
    match message:
        case PoseInFrame(pose=pose):
            return pose
        case Estimate(x=x, y=y, theta=theta) | OdometryPose(x=x, y=y, theta=theta) | RobotState(x=x, y=y, theta=theta):
            return planar_pose(x, y, math.remainder(theta, math.tau))
    raise TypeError(f"{type(message).__name__} is no pose")
