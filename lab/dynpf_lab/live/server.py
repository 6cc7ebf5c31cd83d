"""A small HTTP server on loopback: a page, server-sent events for what is shown, and POST for what a person does.

Its address holds a token. Besides, every request has to name this server as its host, and what acts, or comes from a
script, this page as its origin: so no other page in the same browser reaches it, not even by a name that leads here.
"""

import hmac
import json
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from dynpf_protocol.errors import ProtocolError, UsageError

from dynpf_lab.live.audience import Audience
from dynpf_lab.live.wishes import MOST_BYTES

__all__ = ["Page", "Server", "serving"]

HOSTS = ("127.0.0.1", "localhost")
QUIET_S = 1.0
"""How long a browser that looks on is told nothing; then a comment shows whether it is still there."""

STALLED_S = 10.0
"""How long a browser may take nothing, or say nothing, before its connection is closed."""

MOST_CONNECTIONS = 64

_SEND_BYTES = 64 * 2**10
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Page:
    """What the server shows: the live page as HTML with its policy, and the finished one once it lies at ``finished``.

    ``act`` takes the body of a request to act, or raises ProtocolError; None if nobody may act here.
    """

    def __init__(self, html: str, policy: str, audience: Audience, act: Callable[[bytes], None] | None) -> None:
        self.html, self.policy, self.audience, self.act = html.encode(), policy, audience, act
        self.finished: Path | None = None


class Server(ThreadingHTTPServer):
    """The server of one page, for a bounded number of connections."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, page: Page, port: int = 0) -> None:
        self.page = page
        self.token = secrets.token_urlsafe(24)
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__((HOSTS[0], port), _Handler)

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self.server_address[1])

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{HOSTS[0]}:{self.port}/{self.token}/"

    def process_request(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        """Serve a connection in a thread of its own, unless there are too many."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        """Serve a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a browser that has gone."""


@contextmanager
def serving(page: Page, port: int = 0) -> Iterator[Server]:
    """Serve a page while the block lasts; raises UsageError for a port that is taken."""
    try:
        server = Server(page, port)
    except OSError as error:
        raise UsageError(f"--port {port}: cannot listen there: {error.strerror}") from error
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, name="http", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        page.audience.close()
        server.shutdown()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    """One connection of a browser."""

    server: Server
    protocol_version = "HTTP/1.1"
    timeout = STALLED_S
    server_version, sys_version = "dynpf", ""

    def setup(self) -> None:
        """Let the system hold little of what a browser does not take: the newest frame is to come next."""
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
        super().setup()

    def do_GET(self) -> None:
        """Answer with the page, the stream of events, or the finished page."""
        page, name = self.server.page, self._name()
        if name is None:
            return
        if name == "":
            self._answer(HTTPStatus.OK, page.html, "text/html; charset=utf-8", page.policy)
        elif name == "events":
            self._stream(page.audience)
        elif name == "run.html" and page.finished is not None and page.finished.is_file():
            self._answer(HTTPStatus.OK, page.finished.read_bytes(), "text/html; charset=utf-8")
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page here")

    def do_POST(self) -> None:
        """Do what a person asks for."""
        act, name = self.server.page.act, self._name(acts=True)
        if name is None:
            return
        length = self.headers.get("Content-Length", "")
        if name != "act":
            self._refuse(HTTPStatus.NOT_FOUND, "nothing can be done here")
        elif act is None:
            self._refuse(HTTPStatus.FORBIDDEN, "this page looks on only: it has no operator's key")
        elif self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected application/json")
        elif not (length.isascii() and length.isdecimal() and int(length) <= MOST_BYTES):
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"expected at most {MOST_BYTES} bytes")
        else:
            try:
                act(self.rfile.read(int(length)))
            except ProtocolError as error:
                self._refuse(HTTPStatus.BAD_REQUEST, str(error))
            else:
                self._answer(HTTPStatus.OK, b"{}", "application/json")

    def _name(self, *, acts: bool = False) -> str | None:
        """Return what a request asks for; None, once it is refused, for one that does not come from the page."""
        token, _, name = self.path.removeprefix("/").partition("/")
        own = [f"{host}:{self.server.port}" for host in HOSTS]
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        sites = self.headers.get_all("Sec-Fetch-Site", [])
        if len(hosts) != 1 or hosts[0] not in own:
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST, "this server is not the host that the request names")
        elif not hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self.server.token.encode()):
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page here")
        elif ((acts or origins) and origins != [f"http://{hosts[0]}"]) or (
            sites not in ([], ["same-origin"], ["none"]) and (acts or name == "events")
        ):
            self._refuse(HTTPStatus.FORBIDDEN, "the request comes from another page")
        else:
            return name
        return None

    def _stream(self, audience: Audience) -> None:
        """Send what is shown for as long as the browser takes it."""
        seat = audience.enter()
        if seat is None:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "too many browsers look on already")
            return
        try:
            self.close_connection = True
            self._head(HTTPStatus.OK, "text/event-stream", None)
            self.end_headers()
            while (event := audience.next(seat, QUIET_S)) is not None:
                self.wfile.write(event or b": still there\n\n")
                self.wfile.flush()
        finally:
            audience.leave(seat)

    def _answer(self, status: HTTPStatus, body: bytes, kind: str, policy: str = "") -> None:
        self._head(status, kind, len(body))
        if policy:
            self.send_header("Content-Security-Policy", policy)
        self.end_headers()
        self.wfile.write(body)

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self.close_connection = True
        self._answer(status, json.dumps({"error": why}).encode(), "application/json")

    def _head(self, status: HTTPStatus, kind: str, length: int | None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        if self.close_connection:
            self.send_header("Connection", "close")
        for name, value in _HEADERS.items():
            self.send_header(name, value)

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
        """Say nothing: the terminal is the run's."""
