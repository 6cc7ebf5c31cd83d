"""ROS 2 messages as bytes (CDR, little endian) and as objects, and the hashes of their types (REP 2016), by rosbags."""

from collections.abc import Sequence
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynpf_formats.ros2.keys import NO_HASH, Published

__all__ = ["MOST_BYTES", "BadRosMessageError", "Releases", "RosTypes"]

MOST_BYTES = 16 * 2**20
"""The largest message that is decoded."""

_RELEASES = (Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL, Stores.ROS2_IRON)
_HEADER = b"\x00\x01"  # CDR, little endian
_PARTICLE = "geometry_msgs/Pose pose\nfloat64 weight\n"
_PARTICLE_CLOUD = "std_msgs/Header header\nParticle[] particles\n"


class BadRosMessageError(ValueError):
    """Bytes that are no message of their type."""


class RosTypes:
    """The types of a release of ROS 2, and nav2's particles; those of a bridge are the same from Humble to Lyrical."""

    def __init__(self, release: Stores = Stores.ROS2_JAZZY) -> None:
        self._store = get_typestore(release)
        for name, text in (("Particle", _PARTICLE), ("ParticleCloud", _PARTICLE_CLOUD)):
            self._store.register(get_types_from_msg(text, f"nav2_msgs/msg/{name}"))
        self._hashes: dict[str, str] = {}

    def make(self, kind: str, *values: Any) -> Any:
        """Return a message of a type; ``values`` are its fields in order."""
        return self._store.types[kind](*values)

    def knows(self, kind: str) -> bool:
        """Return whether there is such a type."""
        return kind in self._store.types

    def fields(self, kind: str) -> Sequence[tuple[str, Any]]:
        """Return the fields of a type in their order, as rosbags has them."""
        _, fields = self._store.fielddefs[kind]
        return tuple(fields)

    def hash(self, kind: str) -> str:
        """Return the hash of a type, as it stands in keys."""
        if kind not in self._hashes:
            self._hashes[kind] = self._store.hash_rihs01(kind)
        return self._hashes[kind]

    def definition(self, kind: str) -> str:
        """Return the definition of a type with all that it needs, as rosbag2 writes it (``ros2msg``)."""
        text, _ = self._store.generate_msgdef(kind, ros_version=2)
        return str(text)

    def encode(self, kind: str, message: Any) -> bytes:
        """Return a message as bytes."""
        return bytes(self._store.serialize_cdr(message, kind))

    def decode(self, kind: str, data: bytes) -> Any:
        """Return the message; raises BadRosMessageError.

        The memory is bounded by the size of the bytes: every element of a sequence takes at least one.
        """
        if len(data) > MOST_BYTES:
            raise BadRosMessageError(f"{len(data)} bytes; expected at most {MOST_BYTES}")
        if data[:2] != _HEADER:
            raise BadRosMessageError(f"begins with {data[:4].hex()}; expected CDR, little endian (00010000)")
        try:
            return self._store.deserialize_cdr(data, kind)
        except Exception as error:  # the library lets through what its parts raise on broken bytes
            reason = " ".join(str(error).split())[:200]
            raise BadRosMessageError(f"no {kind}: {reason or type(error).__name__}") from error


class Releases:
    """The types of all releases of ROS 2 that speak rmw_zenoh, found by their hashes."""

    def __init__(self) -> None:
        self._loaded: dict[Stores, RosTypes] = {}

    def types_of(self, published: Published) -> RosTypes | None:
        """Return the types of the release whose type of that name has that hash, None if there is none."""
        for release in (Stores.ROS2_HUMBLE,) if published.hash == NO_HASH else _RELEASES:
            if release not in self._loaded:
                self._loaded[release] = RosTypes(release)
            types = self._loaded[release]
            if types.knows(published.type) and published.hash in (NO_HASH, types.hash(published.type)):
                return types
        return None
