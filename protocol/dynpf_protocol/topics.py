"""The topic table: what travels, who writes it, who it wakes, how it is delivered, and what is kept of it.

Here are the topics that any robot may have. Each system has a table of its own beside its nodes, and a user's node has
its own; the table of a run is made of what its nodes write.
"""

from collections.abc import Mapping
from enum import StrEnum

import msgspec

from dynpf_protocol import messages
from dynpf_protocol.errors import UnknownTopicError
from dynpf_protocol.messages import Message

__all__ = [
    "EVENT_PREFIX",
    "HOST_NODES",
    "LOG_NODE",
    "NODES",
    "TOPICS",
    "Delivery",
    "Topic",
    "is_compared",
    "topic",
]

NODES = ("simulator", "vision", "sensors", "estimator", "controller")
"""The nodes, in the order in which a lockstep tick goes round."""

LOG_NODE = "log"
"""The sender's name of records that a host feeds in from an imported log."""

HOST_NODES = (*NODES, LOG_NODE)
"""Every sender whose messages a node may consume."""


class Delivery(StrEnum):
    """What of a topic a node takes. The bus itself drops nothing: the recorder has to get every message."""

    RELIABLE = "reliable"  # every message counts
    FRESH = "fresh"  # in realtime runs a node takes only the newest that has arrived; in lockstep as reliable


class Topic(msgspec.Struct, frozen=True, kw_only=True):
    """One row of the table."""

    name: str
    type: type[Message]
    publishers: tuple[str, ...]
    description: str
    delivery: Delivery = Delivery.RELIABLE
    wakes: bool = True  # nodes that read it step when it arrives (realtime clock)
    compared: bool = True  # part of "the same run"


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
        description="What the scanner of an imported log measures between, before its first scan and where it changes",
    ),
    Topic(
        name="log/scanner",
        type=messages.Scanner,
        publishers=(LOG_NODE,),
        wakes=False,
        description="What the scanner of an imported log measures between, before its first scan and where it changes",
    ),
    Topic(
        name="log/scan",
        type=messages.LaserScan,
        publishers=(LOG_NODE,),
        description="Range scan of an imported log",
    ),
    Topic(
        name="log/truth",
        type=messages.RobotState,
        publishers=(LOG_NODE,),
        wakes=False,
        description="Reference pose of an imported log; rides along with the next sensor record and wakes nobody",
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
        description="The true world as shapes, for looking at: at most five times a second",
    ),
    Topic(
        name="sensors/odometry",
        type=messages.Odometry,
        publishers=("sensors",),
        description="Forward speed and turning rate as the wheel encoders see them",
    ),
    Topic(
        name="sensors/odometry_pose",
        type=messages.OdometryPose,
        publishers=("sensors",),
        description="Where the wheel encoders put the robot, in a frame of their own",
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
        description="What the scanner measures between, before its first scan and where it changes",
    ),
    Topic(
        name="sensors/scanner",
        type=messages.Scanner,
        publishers=("sensors",),
        wakes=False,
        description="What the scanner measures between, before its first scan and where it changes",
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
        description="The estimated pose, for looking at",
    ),
    Topic(
        name="estimator/dead_reckoning",
        type=messages.PoseInFrame,
        publishers=("estimator",),
        wakes=False,
        description="Where odometry alone would put the robot",
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
        description="Where the estimated robot is in the map, for looking at; sent with the particles",
    ),
    Topic(
        name="estimator/scene",
        type=messages.SceneUpdate,
        publishers=("estimator",),
        wakes=False,
        description="The map and the estimated robot, as shapes for looking at: at most once a second",
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
            description=f"What the host of {node} tells its node about missing inputs",
        )
        for node in NODES
    ),
    Topic(
        name="log",
        type=messages.Log,
        publishers=(*NODES, "recorder"),
        wakes=False,
        compared=False,
        description="Warnings and errors in words",
    ),
    Topic(
        name="diagnostics",
        type=messages.Diagnostics,
        publishers=NODES,
        wakes=False,
        compared=False,
        description="Timings, refusals and queue lengths of each process; wall-clock figures",
    ),
    Topic(
        name="recorder/gap",
        type=messages.Gap,
        publishers=("recorder",),
        wakes=False,
        compared=False,
        description="Sequence numbers that never reached the recorder",
    ),
)

TOPICS: dict[str, Topic] = {row.name: row for row in _ROWS}
"""The topics of the nodes that come with dynpf, by the names that they have where each node has its usual name."""


def topic(name: str, topics: Mapping[str, Topic] = TOPICS) -> Topic:
    """Return the row of a topic; raises UnknownTopicError for a name that is not in the table.

    The log of several robots has the topics of one for each, after the robot's name: ``r1/log/odometry``.
    """
    row = topics.get(name)
    if row is None:
        robot, _, record = name.rpartition("/log/")
        row = TOPICS.get(f"log/{record}") if robot else None
        if row is None:
            raise UnknownTopicError(f"topic {name!r} is not in the topic table")
        row = msgspec.structs.replace(row, name=name)
    return row


def is_compared(name: str) -> bool:
    """Return whether messages of a topic are part of "the same run"; what hosts and recorder say is not."""
    return name not in _UNCOMPARED and not name.startswith(EVENT_PREFIX)


EVENT_PREFIX = "event/"
"""A host tells its node NODE of missing inputs on event/NODE."""

_UNCOMPARED = frozenset(row.name for row in _ROWS if not row.compared)
