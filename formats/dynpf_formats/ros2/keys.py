"""Keys of topics, and liveliness tokens of nodes and endpoints, as rmw_zenoh writes them (Humble to Lyrical).

A topic's key is ``DOMAIN/TOPIC/TYPE/HASH``. A token tells who publishes or subscribes what, and with which quality of
service; without tokens ``ros2 topic list`` shows nothing. Source: ros2/rmw_zenoh, docs/design.md, liveliness_utils.cpp
and qos.cpp.
"""

import re
from typing import NamedTuple

__all__ = [
    "LATCHED",
    "NO_HASH",
    "RELIABLE",
    "SENSOR_DATA",
    "TOKENS",
    "Entity",
    "Published",
    "Qos",
    "dds_type",
    "named_topic",
    "ros_type",
]

TOKENS = "@ros2_lv"
NO_HASH = "TypeHashNotSupported"
"""The hash of every type in Humble."""

DEFAULT_DEPTH = 42
INFINITE = ":,:,:,,"  # deadline, lifespan and liveliness at their defaults

_TYPE = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Za-z][A-Za-z0-9_]*)_")
_HASH = re.compile(r"RIHS01_[0-9a-f]{64}|TypeHashNotSupported")
_TOPIC = re.compile(r"/[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_QOS = re.compile(r"([12]?):([12]?):([12]?),([0-9]{0,9}):[^:]*:[^:]*:[^:]*")
_LONGEST = 1000  # of a key or token, characters


class Qos(NamedTuple):
    """The quality of service of an endpoint, as far as it matters on Zenoh."""

    reliable: bool = True
    latched: bool = False  # transient local: who comes late gets the last ``depth`` messages
    depth: int = DEFAULT_DEPTH

    def text(self) -> str:
        """Return the field of a token, in which a default is empty."""
        reliability, durability = "" if self.reliable else "2", "1" if self.latched else ""
        depth = "" if self.depth == DEFAULT_DEPTH else str(self.depth)
        return f"{reliability}:{durability}:,{depth}{INFINITE}"

    @classmethod
    def parse(cls, text: str) -> "Qos | None":
        """Return what a token's field says, None if it is none."""
        found = _QOS.fullmatch(text)
        if found is None:
            return None
        reliability, durability, _, depth = found.groups()
        return cls(reliability != "2", durability == "1", int(depth) if depth else DEFAULT_DEPTH)

    def profile(self) -> str:
        """Return what rosbag2 writes of a publisher as ``offered_qos_profiles``, from Jazzy on."""
        reliability = "reliable" if self.reliable else "best_effort"
        durability = "transient_local" if self.latched else "volatile"
        ever = "{sec: 9223372036, nsec: 854775807}"
        return (
            f"- {{history: keep_last, depth: {self.depth}, reliability: {reliability}, durability: {durability}, "
            f"deadline: {ever}, lifespan: {ever}, liveliness: automatic, liveliness_lease_duration: {ever}, "
            "avoid_ros_namespace_conventions: false}"
        )


RELIABLE = Qos(depth=10)
SENSOR_DATA = Qos(reliable=False, depth=10)
LATCHED = Qos(latched=True, depth=1)


class Published(NamedTuple):
    """A topic on the wire: its name with leading slash, its type such as ``sensor_msgs/msg/LaserScan``, and hash."""

    topic: str
    type: str
    hash: str

    def key(self, domain: int) -> str:
        """Return the key of its messages."""
        return f"{domain}/{self.topic.strip('/')}/{dds_type(self.type)}/{self.hash}"

    @classmethod
    def parse(cls, key: str) -> "Published | None":
        """Return the topic of a message's key, None if it is no such key."""
        parts = key.split("/")
        if len(parts) < 4 or len(key) > _LONGEST or not parts[0].isdecimal():
            return None
        return _published("/" + "/".join(parts[1:-2]), parts[-2], parts[-1])


class Entity(NamedTuple):
    """A node, or one of its publishers (``kind`` MP) or subscribers (MS), in the session ``zid``."""

    domain: int
    zid: str
    node_id: int
    entity_id: int
    kind: str  # NN, MP or MS
    namespace: str  # "/" or "/robot"
    node: str
    published: Published | None = None
    qos: Qos = Qos()

    def token(self) -> str:
        """Return the key of its liveliness token."""
        own = f"{TOKENS}/{self.domain}/{self.zid}/{self.node_id}/{self.entity_id}/{self.kind}"
        own += f"/%/{_mangled(self.namespace)}/{self.node}"
        if self.published is None:
            return own
        topic, kind, type_hash = self.published
        return f"{own}/{_mangled(topic)}/{dds_type(kind)}/{type_hash}/{self.qos.text()}"

    @classmethod
    def parse(cls, token: str) -> "Entity | None":
        """Return whose token it is; None if it is not that of a node, a publisher or a subscriber."""
        parts = token.split("/")
        if len(token) > _LONGEST or len(parts) not in {9, 13} or parts[0] != TOKENS:
            return None
        domain, zid, node_id, entity_id, kind, _, namespace, node = parts[1:9]
        if not all(re.fullmatch("[0-9]{1,9}", number) for number in (domain, node_id, entity_id)):
            return None
        numbers = (int(domain), zid, int(node_id), int(entity_id))
        if len(parts) == 9:
            return cls(*numbers, kind, _named(namespace), node) if kind == "NN" else None
        published = _published(_named(parts[9]), parts[10], parts[11])
        qos = Qos.parse(parts[12])
        if kind not in {"MP", "MS"} or published is None or qos is None:
            return None
        return cls(*numbers, kind, _named(namespace), node, published, qos)


def dds_type(name: str) -> str:
    """Return the type as it stands in keys: ``sensor_msgs/msg/LaserScan`` as ``sensor_msgs::msg::dds_::LaserScan_``."""
    package, kind, bare = name.split("/")
    return f"{package}::{kind}::dds_::{bare}_"


def ros_type(text: str) -> str | None:
    """Return the type that a key names, None if it is none."""
    found = _TYPE.fullmatch(text)
    return None if found is None else "/".join(found.groups())


def named_topic(topic: str, kind: str) -> bool:
    """Return whether these can be the name of a topic, with leading slash, and that of a type."""
    return _TOPIC.fullmatch(topic) is not None and kind.count("/") == 2 and ros_type(dds_type(kind)) == kind


def _published(topic: str, kind: str, type_hash: str) -> Published | None:
    name = ros_type(kind)
    if name is None or _HASH.fullmatch(type_hash) is None or _TOPIC.fullmatch(topic) is None:
        return None
    return Published(topic, name, type_hash)


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def _named(mangled: str) -> str:
    return mangled.replace("%", "/")
