"""By which way a robot is reached: through a Zenoh router, or as a participant of its DDS domain."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

import msgspec
from dynpf_formats.ros2.keys import Entity, Published, Qos
from dynpf_formats.ros2.robot import Heard

from dynpf_services.ros2.session import RobotSession

__all__ = ["Publisher", "Reach", "Session"]


class Publisher(Protocol):
    """A publisher on a robot's topic."""

    def put(self, payload: bytes, wall_ns: int) -> None:
        """Publish a message."""


class Session(Protocol):
    """What is heard waits; ``dropped`` counts what had no place. See RobotSession and DdsSession."""

    dropped: int

    def wakes(self, wake: Callable[[], None]) -> None:
        """Call ``wake``, in another thread, whenever something arrives."""

    def hear(self, topics: str, kind: str, *, latched: bool = False) -> None:
        """Enqueue messages of a type on ``topics``, a key expression without leading slash."""

    def announce(self, published: Published, qos: Qos) -> None:
        """Let others know that a topic is heard."""

    def writer(self, published: Published, qos: Qos) -> Publisher:
        """Return a publisher."""

    def entities(self) -> Sequence[Entity]:
        """Return the nodes and endpoints that are there now."""

    @property
    def waiting(self) -> bool:
        """Whether something waits."""

    def take(self) -> Heard | None:
        """Return the next message, None if none waits."""


class Reach(msgspec.Struct, frozen=True, kw_only=True):
    """Where a robot is: its router, empty for DDS without one, the form of its topics there, and its domain."""

    endpoint: str
    wire: str
    domain: int

    @property
    def where(self) -> str:
        """The place in words."""
        return f"{self.endpoint}, domain {self.domain}" if self.endpoint else f"DDS, domain {self.domain}"

    def session(self, namespace: str) -> AbstractContextManager[Session]:
        """Open a session; raises UsageError if there is nobody, or no way."""
        if self.endpoint:
            return RobotSession.connect(self.endpoint, self.domain, namespace, self.wire)
        from dynpf_services.ros2.dds import DdsSession  # noqa: PLC0415 - of an extra

        return DdsSession.connect(self.domain)
