"""Estimates as nav2_amcl's ROS messages: pose, particles, the transform map -> odom, and the health as diagnostics.

Frames are named as REP 105 has them. Source: nav2_amcl/src/amcl_node.cpp for topics and stamps.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from dynpf_protocol.messages import Estimate, PosesInFrame, heading, planar_pose
from msgspec import UNSET

from dynpf_formats.importers.poses import Pose, compose, inverse
from dynpf_formats.ros2.keys import LATCHED, RELIABLE, SENSOR_DATA, Qos
from dynpf_formats.ros2.types import RosTypes

__all__ = ["ANSWERS", "TOLERANCE_NS", "AnswerKind", "Answers"]

TOLERANCE_NS = 10**9
"""How far into the future map -> odom is dated, as nav2_amcl's transform_tolerance."""

POSE = "geometry_msgs/msg/Pose"
LEVELS = {"tracking": 0, "uncertain": 1, "lost": 2, "kidnapped": 2, "map_does_not_fit": 2}  # OK, WARN, ERROR


class AnswerKind(NamedTuple):
    """A topic that goes back to the robot: which word of --publish asks for it, its name, type and quality of service.

    ``is_global``: it has the same name for all robots.
    """

    word: str
    topic: str
    type: str
    qos: Qos
    is_global: bool = False


ANSWERS = (
    AnswerKind("pose", "amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", LATCHED),
    AnswerKind("cloud", "particle_cloud", "nav2_msgs/msg/ParticleCloud", SENSOR_DATA),
    AnswerKind("cloud", "particlecloud", "geometry_msgs/msg/PoseArray", SENSOR_DATA),
    AnswerKind("tf", "tf", "tf2_msgs/msg/TFMessage", RELIABLE),
    AnswerKind("diagnostics", "diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE, is_global=True),
)


class Answers:
    """Makes the messages. ``frames`` are the names of map and odometry frame; ``name`` is that of the diagnostics."""

    def __init__(self, types: RosTypes, frames: tuple[str, str], name: str) -> None:
        self._types = types
        self._map, self._odom = frames
        self._name = name

    def pose(self, estimate: Estimate, stamp_ns: int) -> Any:
        """Return the PoseWithCovarianceStamped of an estimate; rows and columns of z, roll and pitch are 0."""
        covariance = np.zeros((6, 6))
        rows = [0, 1, 5]
        covariance[np.ix_(rows, rows)] = np.array(estimate.covariance).reshape(3, 3)
        pose = self._pose(estimate.x, estimate.y, estimate.theta)
        make = self._types.make
        content = make("geometry_msgs/msg/PoseWithCovariance", pose, covariance.reshape(-1))
        return make("geometry_msgs/msg/PoseWithCovarianceStamped", self._header(stamp_ns, self._map), content)

    def clouds(self, cloud: PosesInFrame, stamp_ns: int) -> tuple[Any, Any]:
        """Return particles of equal weight as nav2's ParticleCloud, and as PoseArray."""
        make, header = self._types.make, self._header(stamp_ns, self._map)
        poses = [self._pose(one.position.x, one.position.y, heading(one.orientation)) for one in cloud.poses]
        particles = [make("nav2_msgs/msg/Particle", pose, 1.0 / len(poses)) for pose in poses]
        return make("nav2_msgs/msg/ParticleCloud", header, particles), make(
            "geometry_msgs/msg/PoseArray", header, poses
        )

    def transform(self, estimate: Estimate, odometry: Pose, stamp_ns: int) -> Any:
        """Return map -> odom, by which a robot that odometry sees at ``odometry`` is at the estimate; dated ahead."""
        x, y, theta = compose((estimate.x, estimate.y, estimate.theta), inverse(odometry))
        make, pose = self._types.make, planar_pose(x, y, theta)
        translation = make("geometry_msgs/msg/Vector3", x, y, 0.0)
        rotation = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, pose.orientation.z, pose.orientation.w)
        header = self._header(stamp_ns + TOLERANCE_NS, self._map)
        transform = make("geometry_msgs/msg/Transform", translation, rotation)
        stamped = make("geometry_msgs/msg/TransformStamped", header, self._odom, transform)
        return make("tf2_msgs/msg/TFMessage", [stamped])

    def diagnostics(self, estimate: Estimate, lost: int, refused: int, stamp_ns: int) -> Any:
        """Return the verdict of the filter on itself, its figures, and how many messages were lost and refused."""
        make = self._types.make
        level, text, figures = 0, "the filter does not watch its health", {"n_eff": estimate.n_eff}
        if estimate.health is not UNSET:
            health = estimate.health
            level, text = LEVELS[health.status], f"{health.status}: {health.reason}"
            fields = ((name, getattr(health.figures, name)) for name in health.figures.__struct_fields__)
            figures |= {name: value for name, value in fields if value is not UNSET}
        figures |= {"messages_lost": lost, "messages_refused": refused}
        status = make(
            "diagnostic_msgs/msg/DiagnosticStatus", level, self._name, text, "dynpf", self._pairs(figures.items())
        )
        return make("diagnostic_msgs/msg/DiagnosticArray", self._header(stamp_ns, ""), [status])

    def _pairs(self, figures: Iterable[tuple[str, Any]]) -> list[Any]:
        return [self._types.make("diagnostic_msgs/msg/KeyValue", name, f"{value:.6g}") for name, value in figures]

    def _header(self, stamp_ns: int, frame: str) -> Any:
        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        stamp = self._types.make("builtin_interfaces/msg/Time", seconds, nanoseconds)
        return self._types.make("std_msgs/msg/Header", stamp, frame)

    def _pose(self, x: float, y: float, theta: float) -> Any:
        make, pose = self._types.make, planar_pose(x, y, theta)
        turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, pose.orientation.z, pose.orientation.w)
        return make(POSE, make("geometry_msgs/msg/Point", x, y, 0.0), turned)
