"""A stranger on the bus of a real run: a Zenoh client of its own, which hears what it can and attacks."""

import contextlib
import json
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, SimpleQueue

import zenoh
from dynpf_protocol.keys import OBSERVER, OPERATOR, RUN
from dynpf_runtime.bus.access import Grant
from dynpf_runtime.bus.keys import Credentials, init, issue, load
from dynpf_runtime.machines.effects import Answer, Declare, Put
from dynpf_runtime.machines.events import Arrived, Token

from checks.attacks.kinds import Act, Delete, Kind, Silent, Undeclare, When
from checks.attacks.spy import SOURCE, Spy

__all__ = ["FORGER", "NO_CERTIFICATE", "attack"]

NO_CERTIFICATE = "nobody"
"""The role of a stranger on an encrypted bus that knows the authority, and has no certificate of it."""

FORGER = "forger"
"""The role of a stranger with a certificate of a node's name, which an authority of its own has signed."""

_MIDDLE = 20  # ticks
_MOST = 3000  # acts of one attack
_CONNECTING_S = 10.0


def attack(
    kind: Kind, run: "subprocess.Popen[bytes]", guests: Path | None, role: str, until: float, *, own: Grant | None
) -> int:
    """Attack ``run`` until it has ended or ``until`` has come, and return how often the stranger has acted.

    On a plain bus ``guests`` is None. Else it is the folder with the keys of an observer, by which the stranger
    listens; it acts as ``role``, and leaves out what ``own`` allows to that role.
    """
    words = _router(run, until)
    if not words:
        return 0
    endpoint = words[words.index("--listen") + 1]
    with contextlib.ExitStack() as sessions:
        listening = _connected(run, endpoint, None if guests is None else _keys(guests, OBSERVER))
        if listening is None:
            return 0
        sessions.enter_context(listening)
        acting: zenoh.Session | None = listening
        if guests is not None and role in (NO_CERTIFICATE, FORGER):
            refused = _unknown(guests, sessions) if role == FORGER else _keys(guests, OBSERVER)
            acting = _connected(run, endpoint, refused, proves=role == FORGER, patience_s=1.0)
        elif role != OBSERVER and guests is not None:
            of_run = Path(
                words[words.index("--keys") + 1]
            )  # the keys of the run's own processes, of which one is misused
            acting = _connected(run, endpoint, _keys(guests if role == OPERATOR else of_run, role))
        if acting is None:
            return 0  # the router has taken no link without a certificate
        if acting is not listening:
            sessions.enter_context(acting)
        return _Stranger(kind, listening, acting, own).act_until_ended(run, until)


def _keys(folder: Path, name: str) -> Credentials:
    return load(folder, name, datetime.now(UTC))


def _unknown(guests: Path, sessions: contextlib.ExitStack) -> Credentials:
    """Return a node's credentials of another authority than that of the run, with which they claim to be."""
    folder = Path(sessions.enter_context(tempfile.TemporaryDirectory())) / "keys"
    init(folder, datetime.now(UTC))
    issue(folder, [SOURCE], datetime.now(UTC))
    return _keys(folder, SOURCE)._replace(authority=guests / "ca.pem")


def _router(run: "subprocess.Popen[bytes]", until: float) -> list[str]:
    """Return the command line of a run's router, which says where it listens."""
    while run.poll() is None and time.monotonic() < until:
        for words in _command_lines(run.pid):
            if "router" in words and "--listen" in words:
                return words
        time.sleep(0.01)
    return []


def _command_lines(parent: int) -> Iterator[list[str]]:
    with contextlib.suppress(OSError):
        for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            yield Path(f"/proc/{child}/cmdline").read_text().replace("\0", " ").split()


def _connected(
    run: "subprocess.Popen[bytes]",
    endpoint: str,
    keys: Credentials | None,
    *,
    proves: bool = True,
    patience_s: float = _CONNECTING_S,
) -> zenoh.Session | None:
    """Return a session, or None; who does not prove who it is shows no certificate, and knows the run's authority."""
    config = zenoh.Config()
    settings: dict[str, object] = {"mode": "client", "connect/endpoints": [endpoint]}
    settings |= {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False}
    if keys is not None:
        settings["transport/link/tls/root_ca_certificate"] = str(keys.authority)
    if keys is not None and proves:
        settings |= {
            "transport/link/tls/enable_mtls": True,
            "transport/link/tls/connect_certificate": str(keys.certificate),
            "transport/link/tls/connect_private_key": str(keys.key),
        }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    started = time.monotonic()
    while run.poll() is None and time.monotonic() < started + patience_s:
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(config)
        time.sleep(0.02)
    return None


class _Stranger:
    """Hears through one session, and acts through another or the same."""

    def __init__(self, kind: Kind, listening: zenoh.Session, acting: zenoh.Session, own: Grant | None) -> None:
        self._kind = kind
        self._left_out = [] if own is None else [zenoh.KeyExpr(key) for key in (*own.puts, *own.tokens)]
        self._session = acting
        self._spy = Spy()
        self._queue: SimpleQueue[Arrived | Token] = SimpleQueue()
        self._own: Counter[Arrived] = Counter()
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._held: list[object] = []
        self._acts = 0
        self._done = False

        def enqueue(sample: zenoh.Sample) -> None:
            attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
            if sample.kind == zenoh.SampleKind.PUT:
                self._queue.put(Arrived(str(sample.key_expr), sample.payload.to_bytes(), attachment))

        def notice(sample: zenoh.Sample) -> None:
            self._queue.put(Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        self._held += [listening.declare_subscriber(f"{part}**", enqueue) for part in (RUN, "dynpf/beat/")]
        self._held.append(listening.declare_subscriber("dynpf/control/**", enqueue))
        for token in ("dynpf/alive/**", "dynpf/ready/**"):
            self._held.append(listening.liveliness().declare_subscriber(token, notice, history=True))

    def act_until_ended(self, run: "subprocess.Popen[bytes]", until: float) -> int:
        """Hear and act; return how often it has acted."""
        if self._kind.when is When.JOINING:
            self._act()
        while run.poll() is None and time.monotonic() < until:
            try:
                event = self._queue.get(timeout=0.05)
            except Empty:
                continue
            self._take(event)
        return self._acts

    def _take(self, event: Arrived | Token) -> None:
        if isinstance(event, Token):
            if event.present:
                self._spy.token(event.key)
            return
        if self._own[event] > 0:
            self._own[event] -= 1
            return
        self._spy.hear(event)
        if self._kind.when is not When.JOINING and self._spy.ticks >= _MIDDLE:
            self._act()

    def _act(self) -> None:
        if self._done or self._acts > _MOST:
            return
        self._done = self._kind.when is not When.THROUGHOUT
        for act in self._kind.act(self._spy):
            with contextlib.suppress(zenoh.ZError):  # such as a key that Zenoh does not take
                if self._left_out and any(one.intersects(zenoh.KeyExpr(act.key)) for one in self._left_out):
                    continue
                self._acts += 1
                self._do(act)

    def _do(self, act: Act) -> None:
        match act:
            case Put(key, payload, attachment):
                self._own[Arrived(*act)] += 1
                block = zenoh.CongestionControl.BLOCK
                self._session.put(key, payload, attachment=attachment, congestion_control=block)
            case Declare(key):
                self._tokens[key] = self._session.liveliness().declare_token(key)
            case Undeclare(key):
                self._tokens.pop(key).undeclare()  # type: ignore[no-untyped-call]
            case Answer(key, payload):
                self._held.append(
                    self._session.declare_queryable(key, lambda query: query.reply(key, payload), complete=True)
                )
            case Silent(key):
                queries = self._held
                self._held.append(self._session.declare_queryable(key, queries.append, complete=True))
            case Delete(key):
                self._session.delete(key)
