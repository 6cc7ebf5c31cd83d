"""The topic table: name, type, publishers and delivery of each topic, and whether it wakes nodes and is compared.

These are the topics that any robot may have. Each system has its own table, and user nodes declare their own topics;
the table of a run has the topics that its nodes write.
"""

import re
from collections.abc import Mapping
from enum import StrEnum

import msgspec

from dynpf_protocol import messages
from dynpf_protocol.errors import UnknownTopicError
from dynpf_protocol.keys import OPERATOR
from dynpf_protocol.messages import Message
from dynpf_protocol.snapshots import SNAPSHOT_PREFIX

__all__ = [
    "ACT_PREFIX",
    "EVENT_PREFIX",
    "HOST_NODES",
    "LOG_NODE",
    "MOST_BYTES",
    "NODES",
    "TOPICS",
    "TOPIC_NAME",
    "Delivery",
    "Topic",
    "is_act",
    "is_compared",
    "is_record",
    "topic",
]

NODES = ("simulator", "vision", "sensors", "estimator", "controller")
"""The nodes, in the order of a lockstep tick."""

LOG_NODE = "log"
"""The sender of the records of an imported log, which the source's host publishes."""

ACT_PREFIX = "operator/"
"""What a person does to a simulated world; the source's host publishes it, in the tick in which it enters."""

HOST_NODES = (*NODES, LOG_NODE)
"""Every sender whose messages a node may consume."""


class Delivery(StrEnum):
    """Which messages of a topic a node takes. The bus itself drops none: the recorder has to get every message."""

    RELIABLE = "reliable"  # every message counts
    FRESH = "fresh"  # in realtime a node takes only the newest that has arrived; in lockstep as RELIABLE


MOST_BYTES = 16 * 2**20
"""The largest payload of a topic, bytes, unless its row says another."""

_FEW_BYTES = 64 * 2**10  # of texts and reports of hosts


class Topic(msgspec.Struct, frozen=True, kw_only=True):
    """One row of the table."""

    name: str
    type: type[Message]
    publishers: tuple[str, ...]
    description: str
    delivery: Delivery = Delivery.RELIABLE
    wakes: bool = True  # in realtime, nodes that read it step when it arrives
    compared: bool = True  # part of "the same run"
    most_bytes: int = MOST_BYTES  # of a payload; a larger one is not sent, and refused


_ROWS = (
    Topic(
        name="log/odometry",
        type=messages.Odometry,
        publishers=(LOG_NODE,),
        description="Odometry record of an imported log, as a twist",
    ),
    Topic(
        name="log/odometry_pose",
        type=messages.OdometryPose,
        publishers=(LOG_NODE,),
        description="Odometry record of an imported log, as a pose",
    ),
    Topic(
        name="log/landmarks",
        type=messages.LandmarkReadings,
        publishers=(LOG_NODE,),
        description="Landmark readings of an imported log",
    ),
    Topic(
        name="log/scanner",
        type=messages.Scanner,
        publishers=(LOG_NODE,),
        wakes=False,
        description="Least and greatest range of an imported log's scanner, before its first scan and at each change",
    ),
    Topic(
        name="log/scan",
        type=messages.LaserScan,
        publishers=(LOG_NODE,),
        description="Range scan of an imported log",
    ),
    Topic(
        name="log/initial_pose",
        type=messages.InitialPose,
        publishers=(LOG_NODE,),
        description="Pose that a live robot was told, as by the pose button of rviz",
    ),
    Topic(
        name="log/truth",
        type=messages.RobotState,
        publishers=(LOG_NODE,),
        wakes=False,
        description="Reference pose of an imported log; belongs to the tick of the next sensor record, begins none",
    ),
    Topic(
        name="log/localized",
        type=messages.RobotState,
        publishers=(LOG_NODE,),
        wakes=False,
        description="Pose in the map by the localization that ran on the robot: amcl_pose, or map to odom",
    ),
    *(
        Topic(
            name=f"{ACT_PREFIX}{act}",
            type=type_,
            publishers=(OPERATOR,),
            most_bytes=_FEW_BYTES,
            description=f"A person {does}",
        )
        for act, type_, does in (
            ("drive", messages.Drive, "drives the robot of a simulated world for a moment"),
            ("move", messages.Move, "moves the robot of a simulated world, in any direction, for a moment"),
            ("place", messages.Place, "carries the robot of a simulated world elsewhere"),
            ("body", messages.PlaceBody, "moves a thing of a simulated world, such as a part"),
            ("door", messages.SetDoor, "opens or closes a door of a simulated world"),
            ("map", messages.HoldMap, "has another map of a changing world hold"),
        )
    ),
    Topic(
        name="truth/robot",
        type=messages.RobotState,
        publishers=("simulator",),
        description="True pose and twist of the robot",
    ),
    Topic(
        name="truth/scene",
        type=messages.SceneUpdate,
        publishers=("simulator",),
        wakes=False,
        description="The true world as shapes for viewers, at most five times a second",
    ),
    Topic(
        name="sensors/odometry",
        type=messages.Odometry,
        publishers=("sensors",),
        description="Forward speed and turning rate by the wheel encoders",
    ),
    Topic(
        name="sensors/odometry_pose",
        type=messages.OdometryPose,
        publishers=("sensors",),
        description="Pose by the wheel encoders, in a frame of their own",
    ),
    Topic(
        name="sensors/landmarks",
        type=messages.LandmarkReadings,
        publishers=("sensors",),
        description="Range and bearing to the landmarks in view",
    ),
    Topic(
        name="sensors/scanner",
        type=messages.Scanner,
        publishers=("sensors",),
        wakes=False,
        description="Least and greatest range of the scanner, before its first scan and at each change",
    ),
    Topic(
        name="sensors/scan",
        type=messages.LaserScan,
        publishers=("sensors",),
        delivery=Delivery.FRESH,
        description="Ranges of a scanning sensor on the robot",
    ),
    Topic(
        name="sensors/lines",
        type=messages.LineReadings,
        publishers=("sensors",),
        description="Straight pieces of wall in view, in polar form",
    ),
    Topic(
        name="sensors/position",
        type=messages.PositionFix,
        publishers=("sensors",),
        description="Measured position of the robot in the map",
    ),
    Topic(
        name="sensors/initial_pose",
        type=messages.InitialPose,
        publishers=("sensors",),
        description="Pose at which the filter begins anew",
    ),
    Topic(
        name="estimator/state",
        type=messages.Estimate,
        publishers=("estimator",),
        description="Estimate of the robot's pose, with covariance, effective sample size and health",
    ),
    Topic(
        name="estimator/pose",
        type=messages.PoseInFrame,
        publishers=("estimator",),
        wakes=False,
        description="The estimated pose, for viewers",
    ),
    Topic(
        name="estimator/dead_reckoning",
        type=messages.PoseInFrame,
        publishers=("estimator",),
        wakes=False,
        description="Pose by odometry alone",
    ),
    Topic(
        name="estimator/particles",
        type=messages.PosesInFrame,
        publishers=("estimator",),
        wakes=False,
        description="At most 200 of the particles, to 1 mm and 1 mrad, at most five times a second of logical time",
    ),
    Topic(
        name="estimator/transforms",
        type=messages.FrameTransforms,
        publishers=("estimator",),
        wakes=False,
        description="Pose of the estimated robot in the map, for viewers; published with the particles",
    ),
    Topic(
        name="estimator/scene",
        type=messages.SceneUpdate,
        publishers=("estimator",),
        wakes=False,
        description="The map and the estimated robot as shapes for viewers, at most once a second",
    ),
    Topic(
        name="controller/command",
        type=messages.Command,
        publishers=("controller",),
        wakes=False,
        description="Velocity and turning rate commanded to the robot",
    ),
    *(
        Topic(
            name=f"event/{node}",
            type=messages.HostEvent,
            publishers=(node,),
            wakes=False,
            compared=False,
            most_bytes=_FEW_BYTES,
            description=f"Events about missing inputs of {node}, from its host",
        )
        for node in NODES
    ),
    *(
        Topic(
            name=f"{SNAPSHOT_PREFIX}{node}",
            type=messages.Snapshot,
            publishers=(node,),
            wakes=False,
            compared=False,
            description=f"The whole state of {node} and its host at intervals, for the recording alone",
        )
        for node in NODES
    ),
    Topic(
        name="log",
        type=messages.Log,
        publishers=(*NODES, "recorder"),
        wakes=False,
        compared=False,
        most_bytes=_FEW_BYTES,
        description="What a node, or the recorder, has to say as text",
    ),
    Topic(
        name="notice",
        type=messages.Log,
        publishers=NODES,
        wakes=False,
        compared=False,
        most_bytes=_FEW_BYTES,
        description="What the process of a node has to say as text, such as what it has refused",
    ),
    Topic(
        name="diagnostics",
        type=messages.Diagnostics,
        publishers=NODES,
        wakes=False,
        compared=False,
        most_bytes=_FEW_BYTES,
        description="Timings, refusals and queue lengths of each process, by the wall clock",
    ),
    Topic(
        name="recorder/gap",
        type=messages.Gap,
        publishers=("recorder",),
        wakes=False,
        compared=False,
        most_bytes=_FEW_BYTES,
        description="Sequence numbers that never reached the recorder",
    ),
    Topic(
        name="recorder/restart",
        type=messages.Restart,
        publishers=("recorder",),
        wakes=False,
        compared=False,
        most_bytes=_FEW_BYTES,
        description="Processes that were gone in mid-run, and have been started again",
    ),
)

TOPICS: dict[str, Topic] = {row.name: row for row in _ROWS}
"""The topics that any robot may have, by their names if each node has its usual name."""


def topic(name: str, topics: Mapping[str, Topic] = TOPICS) -> Topic:
    """Return the row of a topic; raises UnknownTopicError for a name that is not in the table.

    The log of several robots has the log topics for each, after the robot's name: ``r1/log/odometry``.
    """
    row = topics.get(name)
    if row is None:
        robot, _, record = name.rpartition("/log/")
        row = TOPICS.get(f"log/{record}") if robot else None
        if row is None:
            raise UnknownTopicError(f"topic {name!r} is not in the topic table")
        row = msgspec.structs.replace(row, name=name)
    return row


def is_record(name: str) -> bool:
    """Return whether a topic is one of an imported log's, of any robot: a source publishes those, read or not."""
    robot, _, record = name.rpartition("log/")
    row = TOPICS.get(f"log/{record}")
    return row is not None and row.publishers == (LOG_NODE,) and (not robot or robot.endswith("/"))


def is_act(name: str) -> bool:
    """Return whether a topic is one of a person's acts, on the world of any robot."""
    robot, _, act = name.rpartition(ACT_PREFIX)
    return f"{ACT_PREFIX}{act}" in _ACTS and (not robot or robot.endswith("/"))


def is_compared(name: str) -> bool:
    """Return whether a topic is part of "the same run"; topics of hosts and the recorder are not."""
    return name not in _UNCOMPARED and not name.startswith((EVENT_PREFIX, SNAPSHOT_PREFIX))


TOPIC_NAME = re.compile(r"[a-z][a-z0-9_]*(/[a-z0-9_]+)*")
"""What the name of a topic looks like."""

EVENT_PREFIX = "event/"
"""The host of node NODE reports missing inputs to it on event/NODE."""

_UNCOMPARED = frozenset(row.name for row in _ROWS if not row.compared)

_ACTS = frozenset(row.name for row in _ROWS if row.publishers == (OPERATOR,))
