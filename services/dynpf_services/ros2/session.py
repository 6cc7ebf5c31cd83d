"""One Zenoh session with a robot's router: what is heard waits in a bounded queue, what is said has number and sender.

It is a client, as the router of rmw_zenoh passes nothing on between peers. When the router comes back after a restart,
Zenoh tells it all subscriptions, publishers and tokens again.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import zenoh
import zenoh.ext
from dynpf_formats.ros2.attachment import Attachment, publisher_id
from dynpf_formats.ros2.keys import NO_HASH, Entity, Published, Qos
from dynpf_formats.ros2.robot import Heard
from dynpf_formats.ros2.types import MOST_BYTES
from dynpf_formats.ros2.wires import RmwZenoh, Ros2dds, Wire

from dynpf_services.ros2.arrivals import Arrivals
from dynpf_services.ros2.client import MOST_WAITING, router_session

__all__ = ["RobotSession", "Writer"]

NODE = "dynpf"
_EACH = 1000  # bytes that a message takes beside its payload
_MOST_TOKENS = 10_000
_TO_OTHERS = zenoh.Locality.REMOTE  # or our own transforms would come back as the robot's


class Writer:
    """A publisher on a robot's topic, with its liveliness token."""

    def __init__(self, session: zenoh.Session, entity: Entity, wire: Wire) -> None:
        token, published, qos = wire.token(entity), entity.published, entity.qos
        assert token is not None and published is not None
        key = wire.key(published)
        self._publisher: zenoh.Publisher | zenoh.ext.AdvancedPublisher
        if qos.latched:
            self._publisher = zenoh.ext.declare_advanced_publisher(
                session,
                key,
                cache=zenoh.ext.CacheConfig(max_samples=qos.depth),
                publisher_detection=True,
                allowed_destination=_TO_OTHERS,
            )
        else:
            drop = zenoh.CongestionControl.DROP
            self._publisher = session.declare_publisher(key, congestion_control=drop, allowed_destination=_TO_OTHERS)
        self._token = session.liveliness().declare_token(token)
        self._id = publisher_id(token) if wire.numbered else None
        self._sequence = 0

    def put(self, payload: bytes, wall_ns: int) -> None:
        """Publish a message."""
        self._sequence += 1
        if self._id is None:
            self._publisher.put(payload)
        else:
            self._publisher.put(payload, attachment=Attachment(self._sequence, wall_ns, self._id).encode())


class RobotSession:
    """An open session; callbacks only enqueue. ``dropped`` counts what had no place in the queue."""

    def __init__(self, session: zenoh.Session, domain: int, namespace: str, wire: Wire) -> None:
        self._session = session
        self._domain, self._namespace, self._wire = domain, namespace, wire
        self._zid = str(session.info.zid())
        self._entities = 1
        self._arrivals: Arrivals[Heard] = Arrivals(MOST_WAITING, MOST_BYTES + _EACH)
        self._wake: Callable[[], None] = lambda: None
        self._wanted: list[
            tuple[zenoh.KeyExpr, str, bool]
        ] = []  # topics, type, latched: heard once tokens tell of them
        self._heard: set[str] = set()
        self._declared: list[object] = []
        self._declare(self._entity(0, "NN"))
        self.dropped = 0

    @classmethod
    @contextmanager
    def connect(cls, endpoint: str, domain: int, namespace: str, wire: str = "rmw_zenoh") -> Iterator["RobotSession"]:
        """Open a session; raises NoRouterError if nothing answers at ``endpoint``. ``wire`` is rmw_zenoh or ros2dds."""
        with router_session(endpoint) as session:
            yield cls(session, domain, namespace, RmwZenoh(domain) if wire == "rmw_zenoh" else Ros2dds())

    def wakes(self, wake: Callable[[], None]) -> None:
        """Call ``wake``, in a thread of Zenoh's, whenever something arrives."""
        self._wake = wake

    def hear(self, topics: str, kind: str, *, latched: bool = False) -> None:
        """Enqueue messages of a type on ``topics``, a key expression without leading slash, whatever the type's hash.

        Of ``latched`` topics the last messages come even if they were published before.
        """
        key = self._wire.expression(topics, kind)
        if key is not None:
            self._subscribe(key, kind, latched=latched)
            return
        self._wanted.append((zenoh.KeyExpr(topics), kind, latched))
        tokens = self._session.liveliness().declare_subscriber(self._wire.tokens, self._appeared, history=True)
        self._declared.append(tokens)

    def _appeared(self, sample: zenoh.Sample) -> None:
        """Hear a publisher that has appeared, if it is wanted."""
        entity = self._wire.entity(str(sample.key_expr))
        if entity is None or entity.kind != "MP" or entity.published is None:
            return
        key, kind = self._wire.key(entity.published), entity.published.type
        for topics, wanted, latched in self._wanted:
            if wanted == kind and key not in self._heard and topics.includes(zenoh.KeyExpr(key)):
                self._heard.add(key)
                self._subscribe(key, kind, latched=latched)

    def _subscribe(self, key: str, kind: str, *, latched: bool) -> None:
        def enqueue(sample: zenoh.Sample) -> None:
            self._enqueue(sample, kind)

        if latched:
            self._declared.append(
                zenoh.ext.declare_advanced_subscriber(
                    self._session,
                    key,
                    enqueue,
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=10),
                )
            )
        else:
            in_order = zenoh.handlers.Callback(enqueue, indirect=False)  # of all topics: a thread each mixes them
            self._declared.append(self._session.declare_subscriber(key, in_order))

    def announce(self, published: Published, qos: Qos) -> None:
        """Declare the token of a subscriber."""
        self._declare(self._entity(self._next(), "MS", published, qos))

    def writer(self, published: Published, qos: Qos) -> Writer:
        """Return a publisher."""
        return Writer(self._session, self._entity(self._next(), "MP", published, qos), self._wire)

    def entities(self) -> Sequence[Entity]:
        """Return the nodes and endpoints that are there now."""
        replies = self._session.liveliness().get(self._wire.tokens, timeout=2.0)
        found = []
        for reply in replies:
            if reply.ok is not None and (entity := self._wire.entity(str(reply.ok.key_expr))) is not None:
                found.append(entity)
            if len(found) >= _MOST_TOKENS:
                break
        return found

    @property
    def waiting(self) -> bool:
        """Whether a message waits."""
        return self._arrivals.waiting

    def take(self) -> Heard | None:
        """Return the next message, None if none waits."""
        return self._arrivals.take()

    def _enqueue(self, sample: zenoh.Sample, kind: str) -> None:
        key, attached = str(sample.key_expr), None
        if self._wire.numbered:
            attached = b"" if sample.attachment is None else sample.attachment.to_bytes()[:1000]
        else:
            key = Published(f"/{key}", kind, NO_HASH).key(self._domain)
        heard = Heard(key, sample.payload.to_bytes(), attached, time.monotonic_ns())
        if self._arrivals.put(heard, len(heard.payload) + _EACH):
            self._wake()
        else:
            self.dropped += 1

    def _declare(self, entity: Entity) -> None:
        token = self._wire.token(entity)
        if token is not None:
            self._declared.append(self._session.liveliness().declare_token(token))

    def _entity(self, number: int, kind: str, published: Published | None = None, qos: Qos | None = None) -> Entity:
        return Entity(self._domain, self._zid, 0, number, kind, self._namespace or "/", NODE, published, qos or Qos())

    def _next(self) -> int:
        self._entities += 1
        return self._entities - 1
