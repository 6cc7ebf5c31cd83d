"""The bus: one Zenoh session of a process.

Every process is a client of the router, which is the only hub: no scouting, no gossip, no shared memory. Callbacks only
enqueue; the owner's main loop does everything else.
"""

import itertools
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import zenoh
from dynpf_protocol.errors import UsageError

from dynpf_runtime.bus.arrivals import Arrivals
from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.probe import refusal
from dynpf_runtime.machines.events import Arrived, Dropped, Token

__all__ = ["Bus", "open_router"]

LEASE_MS = 1500
"""Zenoh drops a peer that has been silent for this long, ms."""

RETRY_MS = 100
"""How often a client looks for a router that is gone, ms."""

HOLD_US = 200_000
"""The hub drops a client that takes nothing for so long, microseconds, after the buffers of its link are full.

Until then it holds up all who send to that, and does so up to three times in a row before it is rid of the client:
less than LEASE_MS in all, or the hub would lose the others. They wait longer for the hub, so as not to drop it.
"""

RECEIVERS = 16
"""Threads by which the hub receives: each that passes a message on to a peer that takes nothing is held up."""

CLOSE_S = 1.0
"""How long the end of a session may take: it sends what is left to all who are connected."""

BROKEN_S = 0.3
"""The same when an error ends it, which is to be told soon."""

MOST_BYTES = 32 * 2**20
"""The largest message that a process takes from its link, which it closes at a larger one; topics allow less."""

_MOST_ANSWERS = 1000


def _config(mode: str, keys: Credentials | None, settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    common = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": MOST_BYTES,
        "connect/retry": {"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS, "period_increase_factor": 1},
    }
    for key, value in {**common, **_tls(mode, keys), **settings}.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _tls(mode: str, keys: Credentials | None) -> dict[str, Any]:
    """Return the settings by which both sides of a link prove who they are."""
    if keys is None:
        return {}
    side = "listen" if mode == "router" else "connect"
    found = {
        "root_ca_certificate": str(keys.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        f"{side}_certificate": str(keys.certificate),
        f"{side}_private_key": str(keys.key),
    }
    return {f"transport/link/tls/{key}": value for key, value in found.items()}


@contextmanager
def open_router(
    endpoint: str, keys: Credentials | None = None, access: Mapping[str, Any] | None = None
) -> Iterator["Bus"]:
    """Open the hub listening at ``endpoint``; raises UsageError if it cannot listen there.

    ``keys`` are needed for an endpoint ``tls/...``; ``access`` is Zenoh's table of what each of its clients may do.
    """
    settings = {
        "listen/endpoints": [endpoint],
        "transport/link/tx/queue/congestion_control/block/wait_before_close": HOLD_US,
        **({} if access is None else {"access_control": access}),
    }
    os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {RECEIVERS}))")
    try:
        session = zenoh.open(_config("router", keys, settings))
    except zenoh.ZError as error:
        reason = "the address is already in use" if "in use" in str(error) else str(error).partition(" at /")[0]
        raise UsageError(
            f"router: cannot listen at {endpoint}: {reason}; stop what runs there or give another --listen"
        ) from error
    with _closed(session):
        yield Bus(session, hub=True)


@contextmanager
def _closed(session: zenoh.Session) -> Iterator[None]:
    """Close a session after the block, without waiting for long: who hangs at its other end may hold that up."""
    patience_s = BROKEN_S
    try:
        yield
        patience_s = CLOSE_S
    finally:
        closing = threading.Thread(target=session.close, daemon=True)
        closing.start()
        closing.join(patience_s)


class Bus:
    """A Zenoh session with one queue for everything that it receives."""

    def __init__(self, session: zenoh.Session, *, hub: bool = False) -> None:
        self._session = session
        self._hub = hub
        self._arrivals = Arrivals()
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared: list[object] = []  # Zenoh undeclares what is garbage collected

    @classmethod
    @contextmanager
    def connect(
        cls,
        endpoint: str,
        tell: Callable[[str], None],
        stopped: Callable[[], bool],
        keys: Credentials | None = None,
    ) -> Iterator["Bus"]:
        """Open a client of the router at ``endpoint``, retrying until the router is there.

        Raises KeyboardInterrupt once ``stopped`` returns true, UsageError for an endpoint that cannot work and for a
        router that refuses ``keys``. ``tell`` prints a notice for the user.
        """
        session = None
        notified = False
        started = time.monotonic()
        while session is None:
            if stopped():
                raise KeyboardInterrupt
            try:
                session = zenoh.open(_config("client", keys, {"connect/endpoints": [endpoint]}))
            except zenoh.ZError as error:
                if "Unable to connect" not in str(error):
                    raise UsageError(f"cannot connect to {endpoint!r}: {str(error).partition(' at /')[0]}") from error
                if not notified and time.monotonic() - started > 1.0:
                    notified = True
                    if why := refusal(endpoint, keys):
                        raise UsageError(f"the router at {endpoint} {why}") from error
                    tell(f"waiting for the router at {endpoint} (dynpf service router SCENARIO)")
                time.sleep(0.05)
        with _closed(session):
            yield cls(session)

    def put(self, key: str, payload: bytes, attachment: bytes = b"") -> None:
        """Publish, waiting while the send queue is full."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
            self._publishers[key] = publisher
        publisher.put(payload, attachment=attachment)

    def subscribe(self, key: str) -> None:
        """Enqueue whatever is published under ``key``."""
        arrivals = self._arrivals

        def enqueue(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            attached = b"" if attachment is None else attachment.to_bytes()
            arrivals.offer(Arrived(str(sample.key_expr), sample.payload.to_bytes(), attached))

        self._declared.append(self._session.declare_subscriber(key, enqueue))

    def watch(self, key: str) -> None:
        """Subscribe to liveliness tokens, including those already present."""
        arrivals = self._arrivals

        def enqueue(sample: zenoh.Sample) -> None:
            arrivals.offer_token(Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        self._declared.append(self._session.liveliness().declare_subscriber(key, enqueue, history=True))

    def declare(self, key: str) -> None:
        """Declare a liveliness token, which disappears with this process."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def tokens(self, key: str) -> list[str]:
        """Return the liveliness tokens that match ``key`` now."""
        replies = self._session.liveliness().get(key, timeout=2.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def answer(self, key: str, payload: bytes) -> None:
        """Answer every query of ``key`` with ``payload``."""
        self._declared.append(self._session.declare_queryable(key, lambda query: query.reply(key, payload)))

    def ask(self, key: str, wanted: bytes = b"", patience_s: float = 1.0) -> bytes | None:
        """Return the answer to the query ``key``: ``wanted`` if anybody gives it, else the first one.

        None if there is none within ``patience_s``, or no one to answer. Everybody is asked: a stranger that answers,
        and be it faster, does not keep the others from it.
        """
        first = None
        everybody, each = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
        replies = self._session.get(key, target=everybody, consolidation=each, timeout=patience_s)
        for reply in itertools.islice(replies, _MOST_ANSWERS):
            if reply.ok is not None:
                answer = reply.ok.payload.to_bytes()
                if answer == wanted:
                    return answer
                first = answer if first is None else first
        return first

    def receive(self, timeout_s: float) -> Arrived | Token | Dropped | None:
        """Return the next item of the queue, or None after ``timeout_s`` or when woken."""
        return self._arrivals.take(timeout_s)

    def wake(self) -> None:
        """Make a waiting ``receive`` return; may be called from a signal handler."""
        self._arrivals.wake()

    def watch_links(self, handle: Callable[[str, str], None]) -> None:
        """Call ``handle``, in a thread of Zenoh's, with common name and address of each client that connects."""

        def linked(event: zenoh.LinkEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                handle(event.link.auth_identifier or "", str(event.link.dst))

        self._declared.append(self._session.info.declare_link_events_listener(linked, history=True))

    @property
    def waiting(self) -> int:
        """The number of items in the queue."""
        return len(self._arrivals)

    @property
    def connected(self) -> bool:
        """Whether the router is connected; always true for the router itself."""
        return self._hub or bool(self._session.info.routers_zid())
