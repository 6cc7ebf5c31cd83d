"""How a robot's topics stand on Zenoh: as rmw_zenoh writes them, or zenoh-bridge-ros2dds for a robot on DDS."""

import re
from typing import NamedTuple, Protocol

from dynpf_formats.ros2.keys import NO_HASH, TOKENS, Entity, Published, Qos, dds_type, named_topic

__all__ = ["RmwZenoh", "Ros2dds", "Wire"]


class Wire(Protocol):
    """Keys and liveliness tokens of one form."""

    @property
    def tokens(self) -> str:
        """The key expression of all tokens."""

    @property
    def numbered(self) -> bool:
        """Whether messages carry number, time and publisher."""

    def expression(self, topics: str, kind: str) -> str | None:
        """Return the key expression of messages of a type on ``topics``; None if tokens alone tell which keys are."""

    def key(self, published: Published) -> str:
        """Return the key of a topic's messages."""

    def token(self, entity: Entity) -> str | None:
        """Return the key of a token; None for an entity that has none in this form."""

    def entity(self, token: str) -> Entity | None:
        """Return whose token it is; None if it is not that of a node, a publisher or a subscriber."""


class RmwZenoh(NamedTuple):
    """The form of rmw_zenoh, in a domain; see keys."""

    domain: int
    numbered: bool = True

    @property
    def tokens(self) -> str:
        """See Wire."""
        return f"{TOKENS}/{self.domain}/**"

    def expression(self, topics: str, kind: str) -> str:
        """See Wire: of whatever hash."""
        return f"{self.domain}/{topics}/{dds_type(kind)}/*"

    def key(self, published: Published) -> str:
        """See Wire."""
        return published.key(self.domain)

    def token(self, entity: Entity) -> str:
        """See Wire."""
        return entity.token()

    def entity(self, token: str) -> Entity | None:
        """See Wire."""
        return Entity.parse(token)


_SLASH = "§"
_QOS = re.compile(r"K?:([01]?):([0-3]?):(?:([01]),(-?[0-9]{1,9}))?")
_LONGEST = 1000  # of a token, characters


class Ros2dds(NamedTuple):
    """The form of zenoh-bridge-ros2dds: the key is the topic and nothing else, and tokens tell the type.

    It knows no nodes, domains and hashes, and messages have no number. Source: eclipse-zenoh/zenoh-plugin-ros2dds,
    liveliness_mgt.rs.
    """

    numbered: bool = False

    @property
    def tokens(self) -> str:
        """See Wire."""
        return f"@/*/{TOKENS}/**"

    def expression(self, topics: str, kind: str) -> str | None:  # noqa: ARG002
        """See Wire."""
        return None if "*" in topics else topics

    def key(self, published: Published) -> str:
        """See Wire."""
        return published.topic.strip("/")

    def token(self, entity: Entity) -> str | None:
        """See Wire."""
        if entity.published is None:
            return None
        key, kind = (text.strip("/").replace("/", _SLASH) for text in entity.published[:2])
        reliable, latched, depth = entity.qos
        return f"@/{entity.zid}/{TOKENS}/{entity.kind}/{key}/{kind}/:{int(reliable)}:{int(latched)}:0,{depth}"

    def entity(self, token: str) -> Entity | None:
        """See Wire. What of the quality of service is left out is as DDS has it: best effort, volatile."""
        parts = token.split("/")
        if len(token) > _LONGEST or len(parts) != 7 or parts[0] != "@" or parts[2] != TOKENS:
            return None
        _, zid, _, kind, key, type_name, quality = parts
        topic, named, found = "/" + key.replace(_SLASH, "/"), type_name.replace(_SLASH, "/"), _QOS.fullmatch(quality)
        if kind not in {"MP", "MS"} or found is None or not named_topic(topic, named):
            return None
        reliability, durability, _, depth = found.groups()
        qos = Qos(reliability == "1", durability not in {"", "0"}, max(int(depth or 1), 1))
        return Entity(0, zid, 0, 0, kind, "/", "", Published(topic, named, NO_HASH), qos)
