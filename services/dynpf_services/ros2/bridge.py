"""The bridge of a run: a robot's messages as records for the run's source, and the run's estimates back to it."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
from dynpf_formats.ros2.answers import ANSWERS, Answers
from dynpf_formats.ros2.keys import NO_HASH, SENSOR_DATA, Published
from dynpf_formats.ros2.robot import LiveReader, RobotPlan
from dynpf_formats.ros2.types import RosTypes
from dynpf_protocol.codec import decode, encode
from dynpf_protocol.envelope import decode_envelope
from dynpf_protocol.errors import BadMessageError, ProtocolError
from dynpf_protocol.keys import data_key, topic_of
from dynpf_protocol.messages import Estimate, HostEvent, Message, PosesInFrame
from dynpf_protocol.topics import LOG_NODE
from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import say
from dynpf_runtime.graph import Graph
from dynpf_runtime.machines.events import Arrived
from dynpf_runtime.source import LiveBatch, LogRecord

from dynpf_services.ros2.reach import Publisher, Reach, Session

__all__ = ["Bridge", "LiveRobot", "opened_bridge"]

STATUS_NS = 10**9
_POLL_S = 0.2


class Bridge(msgspec.Struct, frozen=True, kw_only=True):
    """The settings of a bridge: how the robot is reached, what is heard, and which answers go back."""

    reach: Reach
    namespace: str
    publish: tuple[str, ...]
    humble: bool  # the robot's types have no hashes
    plan: RobotPlan
    observer: str  # folder with the keys by which the bridge hears the run's estimates


class LiveRobot:
    """The records of a robot as they arrive, one that wakes a node for each tick."""

    def __init__(self, session: Session, reader: LiveReader, wakes: frozenset[str]) -> None:
        self._session, self._reader, self._wakes = session, reader, wakes
        self._records: deque[LogRecord] = deque()
        self._batch: list[LogRecord] = []
        self._gaps: list[HostEvent] = []
        self._notices = 0

    @property
    def waiting(self) -> bool:
        """Whether a message or a record waits."""
        return bool(self._records) or self._session.waiting

    def take(self) -> LiveBatch | None:
        """Return the records up to the next that begins a tick, None if there is none yet."""
        while True:
            while self._records:
                record = self._records.popleft()
                self._batch.append(record)
                if record.topic in self._wakes:
                    batch = LiveBatch(tuple(self._batch), tuple(self._gaps))
                    self._batch, self._gaps = [], []
                    return batch
            heard = self._session.take()
            if heard is None:
                return None
            taken = self._reader.take(heard)
            for topic, lost in taken.lost:
                self._gaps.append(HostEvent(kind="gap", topic=topic, node=LOG_NODE, first=lost.first, last=lost.last))
            for topic, stamp_ns, message in taken.records:
                if (payload := self._encoded(topic, message)) is not None:
                    self._records.append(LogRecord(topic, stamp_ns, payload))
            self._tell()

    def _encoded(self, topic: str, message: Message) -> bytes | None:
        try:
            return encode(topic, message)
        except BadMessageError as error:  # a number that is none
            self._reader.refuse(f"{topic}: {error}")
            return None

    def _tell(self) -> None:
        for text in self._reader.notices[self._notices :]:
            say("bridge", text)
        self._notices = len(self._reader.notices)


class _Back:
    """Publishes the estimates of a run to the robot."""

    def __init__(self, bridge: Bridge, session: Session, reader: LiveReader, types: RosTypes) -> None:
        self._session, self._reader, self._types = session, reader, types
        self._answers = Answers(types, ("map", bridge.plan.odom_frame), f"localization{bridge.namespace}")
        self._writers: dict[str, Publisher] = {}
        for kind in ANSWERS:
            if kind.word in bridge.publish:
                published = Published(_topic(bridge, kind.topic, is_global=kind.is_global), kind.type, "")
                published = published._replace(hash=NO_HASH if bridge.humble else types.hash(kind.type))
                self._writers[kind.type] = session.writer(published, kind.qos)
        self._status_ns = 0

    def estimate(self, estimate: Estimate, stamp_ns: int) -> None:
        """Publish what an estimate at a time of the run says."""
        robot_ns = self._reader.robot_ns(stamp_ns)
        self._put("geometry_msgs/msg/PoseWithCovarianceStamped", lambda: self._answers.pose(estimate, robot_ns))
        odometry = self._reader.odometry_at(stamp_ns)
        if odometry is not None:
            self._put("tf2_msgs/msg/TFMessage", lambda: self._answers.transform(estimate, odometry, robot_ns))
        if stamp_ns - self._status_ns >= STATUS_NS:
            self._status_ns = stamp_ns
            lost, refused = self._reader.lost + self._session.dropped, self._reader.refused.total()
            self._put(
                "diagnostic_msgs/msg/DiagnosticArray",
                lambda: self._answers.diagnostics(estimate, lost, refused, robot_ns),
            )

    def cloud(self, cloud: PosesInFrame, stamp_ns: int) -> None:
        """Publish particles."""
        if cloud.poses and "nav2_msgs/msg/ParticleCloud" in self._writers:
            particles, poses = self._answers.clouds(cloud, self._reader.robot_ns(stamp_ns))
            self._put("nav2_msgs/msg/ParticleCloud", lambda: particles)
            self._put("geometry_msgs/msg/PoseArray", lambda: poses)

    def _put(self, kind: str, make: Callable[[], object]) -> None:
        writer = self._writers.get(kind)
        if writer is not None:
            writer.put(self._types.encode(kind, make()), time.time_ns())


def _topic(bridge: Bridge, name: str, *, is_global: bool) -> str:
    """Return the robot's topic of a name: transforms go where the robot's own are."""
    within = f"{bridge.namespace}/{name}"
    if name == "tf" and within not in bridge.plan.transforms:
        is_global = True
    return f"/{name}" if is_global else within


@contextmanager
def opened_bridge(
    bridge: Bridge, graph: Graph, bus: Bus, endpoint: str, observer: Credentials | None
) -> Iterator[LiveRobot]:
    """Connect to the robot; give its records to the run's source, and publish the run's estimates to it."""
    types = RosTypes()
    reader = LiveReader(bridge.plan, types)
    with bridge.reach.session(bridge.namespace) as session:
        robot = LiveRobot(session, reader, graph.waking_records)
        session.wakes(bus.wake)
        for topic, kind in bridge.plan.types.items():
            type_hash = NO_HASH if bridge.humble else types.hash(kind)
            session.announce(Published(topic, kind, type_hash), SENSOR_DATA)
            session.hear(topic.strip("/"), kind)
        back = _Back(bridge, session, reader, types)
        over = threading.Event()
        thread = threading.Thread(
            target=_answer, args=(back, graph, endpoint, observer, over), name="answers", daemon=True
        )
        thread.start()
        try:
            yield robot
        finally:
            over.set()
            thread.join(_POLL_S * 5)


def _answer(back: _Back, graph: Graph, endpoint: str, observer: Credentials | None, over: threading.Event) -> None:
    """Hear the run's estimates, and publish them to the robot, until it is over."""
    rows = {row.name: row for row in graph.topics.values() if row.type in {Estimate, PosesInFrame}}
    try:
        with Bus.connect(endpoint, lambda _text: None, over.is_set, observer) as bus:
            for name, row in rows.items():
                bus.subscribe(data_key(name, row.publishers[0]))
            while not over.is_set():
                arrived = bus.receive(_POLL_S)
                if isinstance(arrived, Arrived):
                    _pass_on(back, graph, arrived)
    except KeyboardInterrupt:
        pass


def _pass_on(back: _Back, graph: Graph, arrived: Arrived) -> None:
    try:
        message = decode(topic_of(arrived.key)[0], arrived.payload, graph.topics)
        stamp_ns = decode_envelope(arrived.attachment).stamp_ns
    except ProtocolError:  # a stranger's, which the run's processes tell of
        return
    match message:
        case Estimate():
            back.estimate(message, stamp_ns)
        case PosesInFrame():
            back.cloud(message, stamp_ns)
