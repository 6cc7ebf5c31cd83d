"""A robot on DDS without a bridge beside it: a participant of its domain, with a RobotSession's methods.

Topics and types are named as ROS 2 names them on DDS. A publisher is heard once it is discovered, with the reliability
and durability that it offers, since a reader that asks for more gets nothing.
"""

import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, Listener, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dynpf_formats.ros2.keys import NO_HASH, Entity, Published, Qos, dds_type, named_topic, ros_type
from dynpf_formats.ros2.robot import Heard
from dynpf_formats.ros2.types import MOST_BYTES, RosTypes
from dynpf_protocol.errors import UsageError
from rosbags.interfaces import Nodetype

from dynpf_services.ros2.arrivals import Arrivals
from dynpf_services.ros2.client import MOST_WAITING

__all__ = ["DdsSession", "DdsTypes", "DdsWriter"]

_TOPICS = "rt"  # what DDS names of ROS topics begin with
_EACH = 1000  # bytes that a message takes beside its payload
_MOST_AT_ONCE = 100
_MOST_PUBLISHERS = 10_000
_BLOCKED_S = 0.1  # how long a reliable writer may wait for who reads slowly
_BASIC = {
    "bool": bool,
    "byte": idl.byte,
    "octet": idl.byte,
    "float32": idl.float32,
    "float64": idl.float64,
    "string": str,
    **{f"{sign}int{bits}": getattr(idl, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
}


class DdsTypes:
    """The types of ROS 2 as those of DDS, made of the same definitions."""

    def __init__(self, types: RosTypes) -> None:
        self._types = types
        self._made: dict[str, Any] = {}

    def __getitem__(self, kind: str) -> Any:
        """Return a type; ``deserialize`` and ``serialize`` of it take and give CDR as ROS has it."""
        if kind not in self._made:
            fields = {name: self._field(*parts) for name, parts in self._types.fields(kind)}
            self._made[kind] = make_idl_struct(kind.rpartition("/")[2], dds_type(kind), fields)
        return self._made[kind]

    def _field(self, node: Nodetype, inner: Any) -> Any:
        if node == Nodetype.NAME:
            return self[inner]
        if node == Nodetype.BASE:
            return _BASIC[inner[0]]
        (element, detail), size = inner
        content = self._field(element, detail)
        return idl.array[content, size] if node == Nodetype.ARRAY else idl.sequence[content]


class DdsWriter:
    """A publisher on a robot's topic."""

    def __init__(self, participant: DomainParticipant, published: Published, qos: Qos, types: DdsTypes) -> None:
        self._type = types[published.type]
        policies = _policies(qos)
        topic = Topic(participant, _TOPICS + published.topic, self._type, qos=policies)
        self._writer = DataWriter(participant, topic, qos=policies)

    def put(self, payload: bytes, wall_ns: int) -> None:  # noqa: ARG002 - DDS dates messages itself
        """Publish a message."""
        self._writer.write(self._type.deserialize(payload))


class DdsSession:
    """A participant; listeners only enqueue. ``dropped`` counts what had no place in the queue."""

    def __init__(self, participant: DomainParticipant, domain: int) -> None:
        self._participant, self._domain = participant, domain
        self._types = DdsTypes(RosTypes())
        self._arrivals: Arrivals[Heard] = Arrivals(MOST_WAITING, MOST_BYTES + _EACH)
        self._wake: Callable[[], None] = lambda: None
        self._wanted: list[tuple[re.Pattern[str], str]] = []  # topics and their type
        self._readers: dict[tuple[Published, bool, bool], DataReader[Any]] = {}
        self._found: dict[Any, Entity] = {}
        self._discovered = threading.Event()
        self.dropped = 0
        self._publications = BuiltinDataReader(
            participant, BuiltinTopicDcpsPublication, listener=_Listener(self._discovering)
        )

    @classmethod
    @contextmanager
    def connect(cls, domain: int) -> Iterator["DdsSession"]:
        """Join a domain; raises UsageError if DDS cannot be used here."""
        try:
            participant = DomainParticipant(domain)
        except DDSException as error:
            raise UsageError(f"--dds: domain {domain} cannot be joined: {error}; see CYCLONEDDS_URI") from error
        yield cls(participant, domain)

    def wakes(self, wake: Callable[[], None]) -> None:
        """Call ``wake``, in a thread of DDS's, whenever something arrives."""
        self._wake = wake

    def hear(self, topics: str, kind: str, *, latched: bool = False) -> None:  # noqa: ARG002 - as it is offered
        """Enqueue messages of a type on ``topics``, a key expression without leading slash."""
        pattern = "".join({"**": ".*", "*": "[^/]*"}.get(part, re.escape(part)) for part in re.split(r"(\*+)", topics))
        self._wanted.append((re.compile("/" + pattern), kind))
        self._look()
        for entity in list(self._found.values()):
            self._read(entity)

    def announce(self, published: Published, qos: Qos) -> None:
        """Do nothing: DDS tells others of readers itself."""

    def writer(self, published: Published, qos: Qos) -> DdsWriter:
        """Return a publisher."""
        return DdsWriter(self._participant, published, qos, self._types)

    def entities(self) -> Sequence[Entity]:
        """Return the publishers that have been discovered."""
        self._look()
        return list(self._found.values())

    @property
    def waiting(self) -> bool:
        """Whether a message waits, or a publisher has been discovered."""
        return self._arrivals.waiting or self._discovered.is_set()

    def take(self) -> Heard | None:
        """Return the next message, None if none waits."""
        if self._discovered.is_set():
            self._look()
        return self._arrivals.take()

    def _discovering(self, _reader: object) -> None:
        self._discovered.set()
        self._wake()

    def _look(self) -> None:
        """Take note of publishers, and hear those that are wanted."""
        self._discovered.clear()
        while samples := self._publications.take(N=_MOST_AT_ONCE):
            for sample in samples:
                if sample.sample_info.valid_data and len(self._found) < _MOST_PUBLISHERS:
                    entity = _entity(sample, self._domain)
                    if entity is not None:
                        self._found[sample.key] = entity
                        self._read(entity)

    def _read(self, entity: Entity) -> None:
        published, qos = entity.published, entity.qos
        assert published is not None
        key = (published, qos.reliable, qos.latched)
        if key in self._readers or not any(
            kind == published.type and pattern.fullmatch(published.topic) for pattern, kind in self._wanted
        ):
            return
        policies = _policies(qos, others_only=True)
        topic = Topic(self._participant, _TOPICS + published.topic, self._types[published.type], qos=policies)
        listener = _Listener(lambda reader: self._enqueue(reader, published))
        self._readers[key] = DataReader(self._participant, topic, qos=policies, listener=listener)

    def _enqueue(self, reader: DataReader[Any], published: Published) -> None:
        for sample in reader.take(N=_MOST_AT_ONCE):
            if sample.sample_info.valid_data:
                payload = sample.serialize(use_version_2=False)
                heard = Heard(published.key(self._domain), payload, None, time.monotonic_ns())
                if not self._arrivals.put(heard, len(payload) + _EACH):
                    self.dropped += 1
        self._wake()


class _Listener(Listener):  # type: ignore[misc]
    """Calls a function in a thread of DDS's when a reader has something."""

    def __init__(self, handle: Callable[[Any], None]) -> None:
        super().__init__()
        self._handle = handle

    def on_data_available(self, reader: Any) -> None:
        """See Listener."""
        self._handle(reader)


def _entity(sample: Any, domain: int) -> Entity | None:
    """Return the publisher that DDS has discovered, None if it is none of a ROS topic."""
    prefix, _, name = sample.topic_name.partition("/")
    kind = ros_type(sample.type_name)
    if prefix != _TOPICS or kind is None or not named_topic(f"/{name}", kind):
        return None
    reliable = sample.qos[Policy.Reliability] != Policy.Reliability.BestEffort
    latched = sample.qos[Policy.Durability] != Policy.Durability.Volatile
    qos = Qos(reliable, latched, depth=1 if latched else 10)
    return Entity(domain, str(sample.participant_key), 0, 0, "MP", "/", "", Published(f"/{name}", kind, NO_HASH), qos)


def _policies(qos: Qos, *, others_only: bool = False) -> DdsQos:
    wait = duration(seconds=_BLOCKED_S)
    own = (Policy.IgnoreLocal.Participant,) if others_only else ()  # or our own transforms would be the robot's
    return DdsQos(
        Policy.Reliability.Reliable(wait) if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        *own,
    )
