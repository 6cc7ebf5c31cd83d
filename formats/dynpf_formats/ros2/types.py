"""ROS 2 messages as bytes (CDR, little endian) and as objects, and the hashes of their types (REP 2016), by rosbags."""

from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

__all__ = ["BadRosMessageError", "RosTypes"]

MOST_BYTES = 16 * 2**20
"""The largest message that is decoded."""

_HEADER = b"\x00\x01"  # CDR, little endian
_PARTICLE = "geometry_msgs/Pose pose\nfloat64 weight\n"
_PARTICLE_CLOUD = "std_msgs/Header header\nParticle[] particles\n"


class BadRosMessageError(ValueError):
    """Bytes that are no message of their type."""


class RosTypes:
    """The types of ROS 2, as far as a bridge uses them the same from Humble to Lyrical, and nav2's particles."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        for name, text in (("Particle", _PARTICLE), ("ParticleCloud", _PARTICLE_CLOUD)):
            self._store.register(get_types_from_msg(text, f"nav2_msgs/msg/{name}"))
        self._hashes: dict[str, str] = {}

    def make(self, kind: str, *values: Any) -> Any:
        """Return a message of a type; ``values`` are its fields in order."""
        return self._store.types[kind](*values)

    def knows(self, kind: str) -> bool:
        """Return whether there is such a type."""
        return kind in self._store.types

    def hash(self, kind: str) -> str:
        """Return the hash of a type, as it stands in keys."""
        if kind not in self._hashes:
            self._hashes[kind] = self._store.hash_rihs01(kind)
        return self._hashes[kind]

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
