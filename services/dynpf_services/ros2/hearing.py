"""Hears keys of Zenoh for a capture: callbacks only enqueue, and what has no place in the queue is noted in its place.

Every subscriber asks for what was published before it came (latched topics). ROS publishers are told that somebody
hears them, since some publish for nobody; their tokens say which quality of service they offer.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence

import zenoh
import zenoh.ext
from dynpf_formats.capture.form import Dropped
from dynpf_formats.capture.writer import MAX_PAYLOAD, Sample
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import Entity, Published, Qos
from dynpf_protocol.errors import UsageError

from dynpf_services.ros2.arrivals import Arrivals
from dynpf_services.ros2.client import MOST_WAITING

__all__ = ["DELETION", "Drops", "Ears", "Heard", "key_expression"]

DELETION = "zenoh/deletion"
"""The encoding by which a capture tells that the value of a key was deleted."""

NODE = "dynpf_record"
_EACH = 1000  # bytes that a message takes beside its payload
_MOST_TOKENS = 10_000
_TOKENS_S = 2.0
_MOST_DROPS = 10_000
_FURTHER = "further keys and publishers"
_LATCHED = 10  # messages of each publisher from before


class Drops:
    """Messages that came one after another and had no place, by publisher; a flood of them takes little memory."""

    def __init__(self) -> None:
        self.dropped: list[Dropped] = []
        self._last: dict[tuple[str, str], int] = {}

    def add(self, dropped: Dropped) -> None:
        """Note messages; of too many publishers and ranges the last ones are told without key and number."""
        if len(self.dropped) >= _MOST_DROPS:
            dropped = Dropped(key=_FURTHER, publisher="", count=dropped.count, at_ns=dropped.at_ns)
        sender = (dropped.key, dropped.publisher)
        place = self._last.get(sender)
        joined = None if place is None else self.dropped[place].with_next(dropped)
        if place is None or joined is None:
            self._last[sender] = len(self.dropped)
            self.dropped.append(dropped)
        else:
            self.dropped[place] = joined


Heard = Sample | Drops


def key_expression(text: str, domain: int) -> zenoh.KeyExpr:
    """Return what is to be heard of a KEY: a key expression, or with a leading slash a ROS topic of any type.

    Raises UsageError.
    """
    expression = f"{domain}/{text.strip('/')}/*/*" if text.startswith("/") else text
    try:
        return zenoh.KeyExpr.autocanonize(expression)
    except zenoh.ZError as error:
        reason = str(error).partition(" at /")[0]
        raise UsageError(f"{text!r}: no key expression of Zenoh, nor a ROS topic such as /scan: {reason}") from error


class Ears:
    """Subscribers of key expressions in an open session; ``wake`` is called in Zenoh's threads when something came."""

    def __init__(
        self, session: zenoh.Session, keys: Sequence[zenoh.KeyExpr], domain: int, *, ros: bool, wake: Callable[[], None]
    ) -> None:
        self._session, self._keys, self._domain, self._wake = session, keys, domain, wake
        self._arrivals: Arrivals[Heard] = Arrivals(MOST_WAITING, MAX_PAYLOAD + _EACH)
        self._tokens: deque[str] = deque(maxlen=_MOST_TOKENS)
        self._announced: set[Published] = set()
        self._offered: dict[str, Qos] = {}  # by topic
        self._zid = str(session.info.zid())
        own = Entity(domain, self._zid, 0, 0, "NN", "/", NODE)
        liveliness = session.liveliness()
        self._declared: list[object] = []
        if ros:
            tokens = f"@ros2_lv/{domain}/**"
            self._declared.append(liveliness.declare_token(own.token()))
            self._declared.append(liveliness.declare_subscriber(tokens, self._token))
            for reply in liveliness.get(tokens, timeout=_TOKENS_S):  # before what is latched comes, which needs them
                if reply.ok is not None:
                    self._token(reply.ok)
            self.announce()
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=_LATCHED)
        for place, key in enumerate(keys):
            hear = self._hearing(keys[:place])
            self._declared.append(zenoh.ext.declare_advanced_subscriber(session, key, hear, history=history))

    @property
    def waiting(self) -> bool:
        """Whether something waits."""
        return self._arrivals.waiting

    def take(self) -> Heard | None:
        """Return the next that was heard, None if nothing waits."""
        return self._arrivals.take()

    def router(self) -> str:
        """Return the name of the router, an empty text if there is none."""
        return next((str(zid) for zid in self._session.info.routers_zid()), "")

    def qos_of(self, topic: str) -> Qos | None:
        """Return what the publishers of a ROS topic offer, None if that is not known."""
        return self._offered.get(topic)

    def announce(self) -> None:
        """Let the publishers that have appeared on the topics to be heard know that they are heard."""
        while self._tokens:
            entity = Entity.parse(self._tokens.popleft())
            if entity is None or entity.kind != "MP" or entity.published is None or entity.zid == self._zid:
                continue
            published = entity.published
            if published in self._announced or len(self._announced) >= _MOST_TOKENS:
                continue
            key = published.key(self._domain)
            if any(expression.intersects(key) for expression in self._keys):
                self._announced.add(published)
                self._offered.setdefault(published.topic, entity.qos)
                number = len(self._announced)
                own = Entity(self._domain, self._zid, 0, number, "MS", "/", NODE, published, entity.qos)
                self._declared.append(self._session.liveliness().declare_token(own.token()))

    def _token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._tokens.append(str(sample.key_expr))

    def _hearing(self, others: Sequence[zenoh.KeyExpr]) -> Callable[[zenoh.Sample], None]:
        """Return the callback of a subscriber, which leaves to the ``others`` what they hear, too."""

        def hear(sample: zenoh.Sample) -> None:
            key = sample.key_expr
            if not any(other.includes(key) for other in others):
                self._enqueue(sample)

        return hear

    def _enqueue(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        attached = b"" if attachment is None else attachment.to_bytes()[:1000]
        encoding = DELETION if sample.kind == zenoh.SampleKind.DELETE else str(sample.encoding)
        heard = Sample(str(sample.key_expr), sample.payload.to_bytes(), attached, encoding, time.time_ns())
        self._arrivals.put(heard, len(heard.payload) + _EACH, lambda last: _noted(heard, last))
        self._wake()


def _noted(sample: Sample, last: Heard | None) -> Drops | None:
    """Note in the queue's last item that a message had no place; return an item to do it in, if the last is none."""
    drops = last if isinstance(last, Drops) else Drops()
    drops.add(Dropped.of(sample.key, Attachment.found(sample.attachment), sample.arrival_ns))
    return None if drops is last else drops
