"""A live robot's messages as the records of a log, one by one: the importer of bags, applied to what arrives."""

from collections import Counter, defaultdict, deque
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.messages import OdometryPose
from dynpf_protocol.printable import printable

from dynpf_formats.importers.bag_plan import MAPS, TF, BagPlan, frame_of
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.log import Losses, Record
from dynpf_formats.importers.poses import Pose
from dynpf_formats.importers.rosbag import BagChoice, RecordReader
from dynpf_formats.importers.scans import SCANNER
from dynpf_formats.ros2.attachment import Attachment, BadAttachmentError, Lost, Numbers
from dynpf_formats.ros2.clock import RobotClock
from dynpf_formats.ros2.keys import Published
from dynpf_formats.ros2.types import BadRosMessageError, RosTypes

__all__ = ["Heard", "LiveReader", "RobotPlan", "Said", "Taken", "opened"]

_MOST_POSES = 2000


class Heard(NamedTuple):
    """A message as it came from the robot: its key, its bytes, and when it arrived (ns, a clock that only goes on)."""

    key: str
    payload: bytes
    attachment: bytes
    arrival_ns: int


class RobotPlan(msgspec.Struct, frozen=True, kw_only=True):
    """Which topics and frames of a robot are heard: a BagPlan that can be written down, and the odometry's frame."""

    scan: str
    is_cloud: bool
    odometry: str | None
    truth: str | None
    transforms: tuple[str, ...]
    base: str
    odom_frame: str
    odom_child: str
    to_base: tuple[float, float, float]
    mount: tuple[tuple[float, ...], ...]
    range_max: float | None
    types: dict[str, str]  # topic -> type

    @classmethod
    def of(cls, plan: BagPlan, odom_frame: str, types: dict[str, str]) -> "RobotPlan":
        """Return the plan of a robot, whose odometry is given in ``odom_frame``.

        Its own localization, if it has one, is not heard.
        """
        own = {name: value for name, value in plan._asdict().items() if name != "localized"}
        taken = own | {"odom_frame": odom_frame, "mount": tuple(map(tuple, plan.mount.tolist()))}
        heard = [plan.scan, plan.odometry, plan.truth, *(plan.transforms if plan.odometry == TF else ())]
        return cls(**taken, types={topic: types[topic] for topic in heard if topic in types})

    def bag_plan(self) -> BagPlan:
        """Return the plan as the importer of bags takes it."""
        values = {name: getattr(self, name, None) for name in BagPlan._fields}
        return BagPlan(**values | {"mount": np.array(self.mount)})


class Taken(NamedTuple):
    """The records of a message, and the messages that were lost before it, each with the record's topic."""

    records: tuple[Record, ...] = ()
    lost: tuple[tuple[str, Lost], ...] = ()


class Said:
    """What a robot has said so far, as a bag is read: topics, types and messages."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        self._messages: list[Message] = []

    def add(self, kind: str, message: Message) -> None:
        """Add a message of a type."""
        self.topics[message.topic] = kind
        self._messages.append(message)

    def of_type(self, *types: str) -> list[str]:
        """Return the topics of the given types, by name."""
        return sorted(name for name, kind in self.topics.items() if kind in types)

    def messages(self, topics: Collection[str], _losses: Losses) -> Iterator[Message]:
        """Yield the messages of the given topics in the order of arrival."""
        return (message for message in self._messages if message.topic in topics)

    def odom_frame(self, plan: BagPlan) -> str:
        """Return the frame in which the robot's odometry is given."""
        first = next(self.messages({plan.odometry or ""}, Losses()), None)
        return plan.odom_frame if first is None else frame_of(first.content) or plan.odom_frame

    def map(self) -> Any | None:
        """Return the newest map, None if there is none."""
        maps = list(self.messages(self.of_type(MAPS), Losses()))
        return maps[-1].content if maps else None


def opened(heard: Heard, types: RosTypes) -> tuple[Published, Attachment, Any]:
    """Return topic, attachment and content of a message.

    Raises BadAttachmentError or BadRosMessageError, whose text begins with the topic.
    """
    published = Published.parse(heard.key)
    if published is None:
        raise BadRosMessageError(f"{printable(heard.key)[:200]}: no key of a ROS 2 topic")
    try:
        attachment = Attachment.decode(heard.attachment)
        content = types.decode(published.type, heard.payload)
    except (BadAttachmentError, BadRosMessageError) as error:
        raise type(error)(f"{published.topic}: {error}") from error
    return published, attachment, content


class LiveReader:
    """Makes records of a robot's messages by a plan; counts and tells what it refuses.

    Records are given in the order of arrival; their stamps are the robot's, but where its clock jumps.
    """

    def __init__(self, plan: RobotPlan, types: RosTypes) -> None:
        self._plan = plan
        self._types = types
        self._losses = Losses()
        self._reader = RecordReader(plan.bag_plan(), BagChoice(), self._losses)
        self._clock = RobotClock()
        self._numbers: defaultdict[str, Numbers] = defaultdict(Numbers)
        self._scanner: Record | None = None
        self._odometry: deque[tuple[int, Pose]] = deque(maxlen=_MOST_POSES)
        self.refused: Counter[str] = Counter()
        self.lost = 0
        self.notices: list[str] = []

    def take(self, heard: Heard) -> Taken:
        """Return the records of a message; none for one that is refused."""
        try:
            published, attachment, content = opened(heard, self._types)
            if self._plan.types.get(published.topic) != published.type:
                raise BadRosMessageError(f"{published.topic}: is {published.type} now")
            lost = self._numbers[published.topic].see(attachment)
            made = list(self._reader.read(Message(published.topic, heard.arrival_ns, content)))
        except (BadAttachmentError, BadRosMessageError) as error:
            self.refuse(str(error))
            return Taken()
        except Exception as error:  # a decoded message of which any field may be anything
            self.refuse(f"{published.topic}: cannot be read: {type(error).__name__}: {str(error)[:200]}")
            return Taken()
        self._tell_losses()
        records = [record for group in made for record in self._timed(group, heard.arrival_ns)]
        if lost is None:
            return Taken(tuple(records))
        self.lost += lost.last - lost.first + 1
        topic = "log/scan" if published.topic == self._plan.scan else "log/odometry_pose"
        return Taken(tuple(records), ((topic, lost),))

    def odometry_at(self, stamp_ns: int) -> Pose | None:
        """Return the newest pose by odometry that is not after a time of the run."""
        return next((pose for at_ns, pose in reversed(self._odometry) if at_ns <= stamp_ns), None)

    def robot_ns(self, stamp_ns: int) -> int:
        """Return the robot's time of a time in the run."""
        return self._clock.robot_ns(stamp_ns)

    def _timed(self, group: tuple[Record, ...], arrival_ns: int) -> list[Record]:
        """Return records of one moment at their times in the run, without a scanner's limits if they are as before."""
        told = self._clock.take(group[-1].stamp_ns, arrival_ns)
        if told is None:
            self.refuse(f"{group[-1].topic}: a stamp of {group[-1].stamp_ns * 1e-9:.3f} s, unlike those before")
            return []
        if told.jumped:
            self.notices.append("the robot's clock has jumped; the run's time goes on")
        timed = [record._replace(stamp_ns=told.stamp_ns) for record in group]
        found = []
        for record in timed:
            if record.topic == SCANNER:
                if self._scanner is not None and record.message == self._scanner.message:
                    continue
                self._scanner = record
            if isinstance(record.message, OdometryPose):
                self._odometry.append((record.stamp_ns, (record.message.x, record.message.y, record.message.theta)))
            found.append(record)
        return found

    def refuse(self, reason: str) -> None:
        """Count a message or a part of one that is left out, and tell of the first of its kind."""
        kind = reason.partition(":")[0]
        self.refused[kind] += 1
        if self.refused[kind] == 1:
            self.notices.append(f"refused, and later ones like it: {printable(reason)}")

    def _tell_losses(self) -> None:
        for reason, dropped in self._losses.summary().items():
            if f"left out: {reason}" not in self.refused:
                self.notices.append(f"left out: {reason}, such as {printable(dropped.first)}")
            self.refused[f"left out: {reason}"] = dropped.count
