"""A live robot's messages as the records of a log, one by one: the importer of bags, applied to what arrives."""

import math
from collections import Counter, defaultdict, deque
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np
from dynpf_protocol.messages import InitialPose, OdometryPose
from dynpf_protocol.printable import printable

from dynpf_formats.importers.bag_plan import MAPS, TF, TRANSFORMS, WITH_COVARIANCE, BagPlan, frame_of
from dynpf_formats.importers.bags import Message
from dynpf_formats.importers.log import Losses, Record
from dynpf_formats.importers.poses import Pose
from dynpf_formats.importers.rosbag import BagChoice, RecordReader
from dynpf_formats.importers.scans import SCANNER
from dynpf_formats.importers.transforms import TransformTree, matrix, planar
from dynpf_formats.ros2.attachment import Attachment, BadAttachmentError, Lost, Numbers
from dynpf_formats.ros2.clock import RobotClock
from dynpf_formats.ros2.gyro import GyroHeading
from dynpf_formats.ros2.keys import Published
from dynpf_formats.ros2.types import BadRosMessageError, RosTypes

__all__ = ["CLOCK", "IMU", "INITIAL_POSE", "Heard", "LiveReader", "RobotPlan", "Said", "Taken", "opened"]

IMU, CLOCK, INITIAL_POSE = "sensor_msgs/msg/Imu", "rosgraph_msgs/msg/Clock", WITH_COVARIANCE
_LOCALIZED = "log/localized"  # the robot's own localization, or our answers
_CLOCK_TOPIC = "/clock"  # one for all robots, as in ROS
_MOST_POSES = 2000


class Heard(NamedTuple):
    """A message as it came from the robot: its key, its bytes, and when it arrived (ns, a clock that only goes on).

    The key is as rmw_zenoh has it. ``attachment`` is None where messages have none.
    """

    key: str
    payload: bytes
    attachment: bytes | None
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
    initial_pose: str  # topic of poses that the robot is told
    imu: str | None = None  # topic of the gyro by which odometry turns
    imu_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)  # the robot's vertical axis in the frame of the gyro
    types: dict[str, str]  # topic -> type

    @classmethod
    def of(cls, plan: BagPlan, odom_frame: str, types: dict[str, str], namespace: str = "") -> "RobotPlan":
        """Return the plan of a robot, whose odometry is given in ``odom_frame``.

        Its own localization, if it has one, is not heard.
        """
        own = {name: value for name, value in plan._asdict().items() if name != "localized"}
        told = f"{namespace}/initialpose"
        taken = own | {"odom_frame": odom_frame, "mount": tuple(map(tuple, plan.mount.tolist())), "initial_pose": told}
        heard = [plan.scan, plan.odometry, plan.truth, *(plan.transforms if plan.odometry == TF else ())]
        further = {told: INITIAL_POSE, _CLOCK_TOPIC: CLOCK}
        return cls(**taken, types={topic: types[topic] for topic in heard if topic in types} | further)

    def with_imu(self, topic: str, axis: tuple[float, float, float]) -> "RobotPlan":
        """Return the plan with odometry that turns as a gyro does, whose frame has the vertical along ``axis``."""
        return msgspec.structs.replace(self, imu=topic, imu_axis=axis, types=self.types | {topic: IMU})

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

    def vertical_of(self, frame: str, base: str) -> tuple[float, float, float] | None:
        """Return the vertical axis of ``base`` in another frame; None if the transform is not known."""
        tree = TransformTree()
        for message in self.messages(self.of_type(*TRANSFORMS), Losses()):
            for transform in message.content.transforms:
                found = matrix(transform.transform.translation, transform.transform.rotation)
                if found is not None:
                    tree.put(frame_of(transform), str(transform.child_frame_id).lstrip("/"), found)
        between = tree.find(base, frame)
        return None if between is None else (float(between[2, 0]), float(between[2, 1]), float(between[2, 2]))

    def map(self) -> Any | None:
        """Return the newest map, None if there is none."""
        maps = list(self.messages(self.of_type(MAPS), Losses()))
        return maps[-1].content if maps else None


def opened(heard: Heard, types: RosTypes) -> tuple[Published, Attachment | None, Any]:
    """Return topic, attachment and content of a message; None for an attachment that there need not be.

    Raises BadAttachmentError or BadRosMessageError, whose text begins with the topic.
    """
    published = Published.parse(heard.key)
    if published is None:
        raise BadRosMessageError(f"{printable(heard.key)[:200]}: no key of a ROS 2 topic")
    try:
        attachment = None if heard.attachment is None else Attachment.decode(heard.attachment)
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
        self._gyro = GyroHeading()
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
            lost = None if attachment is None else self._numbers[published.topic].see(attachment)
            made = self._made(published.topic, content, heard.arrival_ns)
        except (BadAttachmentError, BadRosMessageError) as error:
            self.refuse(str(error))
            return Taken()
        except Exception as error:  # a decoded message of which any field may be anything
            self.refuse(f"{published.topic}: cannot be read: {type(error).__name__}: {str(error)[:200]}")
            return Taken()
        self._tell_losses()
        if lost is None or published.topic in {_CLOCK_TOPIC, self._plan.imu}:
            return Taken(tuple(made))
        self.lost += lost.last - lost.first + 1
        topics = {self._plan.scan: "log/scan", self._plan.initial_pose: "log/initial_pose"}
        return Taken(tuple(made), ((topics.get(published.topic, "log/odometry_pose"), lost),))

    def odometry_at(self, stamp_ns: int) -> Pose | None:
        """Return the newest pose by odometry that is not after a time of the run."""
        return next((pose for at_ns, pose in reversed(self._odometry) if at_ns <= stamp_ns), None)

    def robot_ns(self, stamp_ns: int) -> int:
        """Return the robot's time of a time in the run."""
        return self._clock.robot_ns(stamp_ns)

    def _made(self, topic: str, content: Any, arrival_ns: int) -> list[Record]:
        """Return the records of a message; raises what a field that is not as it should be leads to."""
        if topic == _CLOCK_TOPIC:  # so that it is known how the time of a simulator passes
            self._told(_ns(content.clock), arrival_ns)
            return []
        if topic == self._plan.imu:
            rates = content.angular_velocity
            along = zip(self._plan.imu_axis, (rates.x, rates.y, rates.z), strict=True)
            rate = sum(part * float(rate) for part, rate in along)
            if not math.isfinite(rate):
                raise BadRosMessageError(f"{topic}: a turning rate of {rate} rad/s")
            self._gyro.take(_ns(content.header.stamp), rate)
            return []
        if topic == self._plan.initial_pose:
            now_ns = self._clock.now_ns(arrival_ns)
            if now_ns is None:
                raise BadRosMessageError(f"{topic}: a pose before the first scan or odometry")
            return [Record("log/initial_pose", now_ns, _initial_pose(topic, content))]
        groups = self._reader.read(Message(topic, arrival_ns, content))
        return [record for group in groups for record in self._timed(group, arrival_ns)]

    def _told(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Return the time in the run of a stamp, None if it is doubtful; tell that the clock has jumped."""
        told = self._clock.take(stamp_ns, arrival_ns)
        if told is None:
            return None
        if told.jumped:
            self.notices.append("the robot's clock has jumped; the run's time goes on")
        return told.stamp_ns

    def _timed(self, group: tuple[Record, ...], arrival_ns: int) -> list[Record]:
        """Return records of one moment at their times in the run, without a scanner's limits if they are as before."""
        stamp_ns = group[-1].stamp_ns
        told_ns = self._told(stamp_ns, arrival_ns)
        if told_ns is None:
            self.refuse(f"{group[-1].topic}: a stamp of {stamp_ns * 1e-9:.3f} s, unlike those before")
            return []
        found = []
        for record in (record._replace(stamp_ns=told_ns) for record in group if record.topic != _LOCALIZED):
            if record.topic == SCANNER:
                if self._scanner is not None and record.message == self._scanner.message:
                    continue
                self._scanner = record
            if isinstance(record.message, OdometryPose):
                pose = (record.message.x, record.message.y, record.message.theta)
                self._odometry.append((told_ns, pose))  # as the robot has it, for its transform
                if self._plan.imu is not None:
                    x, y, theta = self._gyro.corrected(stamp_ns, pose)
                    found.append(record._replace(message=OdometryPose(x=x, y=y, theta=theta)))
                    continue
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


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _initial_pose(topic: str, content: Any) -> InitialPose:
    """Return what a PoseWithCovarianceStamped tells; raises BadRosMessageError."""
    frame = frame_of(content)
    if frame not in {"", "map"}:
        raise BadRosMessageError(f"{topic}: a pose in the frame {frame!r}; expected map")
    found = matrix(content.pose.pose.position, content.pose.pose.orientation)
    if found is None:
        raise BadRosMessageError(f"{topic}: no pose of finite numbers")
    x, y, theta = planar(found)
    rows = np.ix_((0, 1, 5), (0, 1, 5))
    covariance = np.asarray(content.pose.covariance, dtype=np.float64).reshape(6, 6)[rows]
    return InitialPose(x=x, y=y, theta=theta, covariance=tuple((0.5 * (covariance + covariance.T)).ravel().tolist()))
