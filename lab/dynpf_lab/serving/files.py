"""A server on loopback that gives a few files, whole or in ranges, to the web page of one viewer.

Each server has a token in its addresses, so that no other page finds the files, and tells browsers which page may read
them. It answers those alone who name it by its own address.
"""

import re
import secrets
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO
from urllib.parse import urlsplit

__all__ = ["FileServer", "Handler"]

_RANGE = re.compile(r"bytes=(\d*)-(\d*)")
_BLOCK = 1 << 20


class FileServer(ThreadingHTTPServer):
    """Serves ``files``, paths by name, on a free port of loopback to pages of the origin ``page``."""

    daemon_threads = True

    def __init__(self, files: Mapping[str, Path], page: str, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), Handler)
        self.files, self.page = dict(files), page
        self.token = secrets.token_urlsafe(12)

    def address(self, name: str) -> str:
        """Return the address of a file."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/{name}"


class Handler(BaseHTTPRequestHandler):
    """Answers a request for a file, or for leave to read it."""

    server: FileServer
    protocol_version = "HTTP/1.1"

    def do_OPTIONS(self) -> None:
        """Tell a browser that the viewer's page may ask for ranges."""
        if self._file() is None:
            return
        self.send_response(HTTPStatus.NO_CONTENT)
        self._allow()
        self.send_header("Access-Control-Allow-Methods", "GET, HEAD, OPTIONS")
        self.send_header("Access-Control-Allow-Headers", "Range")
        self.send_header("Access-Control-Allow-Private-Network", "true")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def do_HEAD(self) -> None:
        """Tell how large a file is, and that it can be had in ranges."""
        self._answer(with_content=False)

    def do_GET(self) -> None:
        """Send a file, or a range of it."""
        self._answer(with_content=True)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class names it so
        """Say nothing of requests."""

    def _file(self) -> Path | None:
        """Return the file that is asked for, or refuse the request and return None."""
        own = {f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")}
        origin = self.headers.get("Origin")
        if self.headers.get("Host") not in own or origin not in (None, self.server.page):
            self._refuse(HTTPStatus.FORBIDDEN)
            return None
        token, _, name = urlsplit(self.path).path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.server.token.encode()) or name not in self.server.files:
            self._refuse(HTTPStatus.NOT_FOUND)
            return None
        return self.server.files[name]

    def _answer(self, *, with_content: bool) -> None:
        path = self._file()
        if path is None:
            return
        with path.open("rb") as file:
            size = path.stat().st_size
            first, last = 0, size - 1
            if (asked := self.headers.get("Range")) is not None:
                found = _span(asked, size)
                if found is None:
                    self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, size)
                    return
                first, last = found
            self.send_response(HTTPStatus.OK if asked is None else HTTPStatus.PARTIAL_CONTENT)
            self._allow()
            self.send_header("Accept-Ranges", "bytes")
            self.send_header(
                "Content-Type", "application/json" if path.suffix == ".json" else "application/octet-stream"
            )
            self.send_header("Content-Length", str(last - first + 1))
            if asked is not None:
                self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
            self.end_headers()
            if with_content:
                self._send(file, first, last)

    def _send(self, file: BinaryIO, first: int, last: int) -> None:
        file.seek(first)
        left = last - first + 1
        try:
            while left and (block := file.read(min(left, _BLOCK))):
                self.wfile.write(block)
                left -= len(block)
        except ConnectionError:
            self.close_connection = True  # the viewer has what it needs

    def _allow(self) -> None:
        self.send_header("Access-Control-Allow-Origin", self.server.page)
        self.send_header("Access-Control-Expose-Headers", "Accept-Ranges, Content-Length, Content-Range")
        self.send_header("Vary", "Origin")

    def _refuse(self, status: HTTPStatus, size: int | None = None) -> None:
        self.send_response(status)
        if size is not None:
            self.send_header("Content-Range", f"bytes */{size}")
        self.send_header("Content-Length", "0")
        self.end_headers()


def _span(asked: str, size: int) -> tuple[int, int] | None:
    """Return the first and the last byte of a range; None for one that the file does not have."""
    found = _RANGE.fullmatch(asked)
    if found is None or found[0] == "bytes=-":
        return None
    if not found[1]:  # so many at the end
        first, last = max(0, size - int(found[2])), size - 1
    else:
        first, last = int(found[1]), min(size - 1, int(found[2] or size - 1))
    return (first, last) if first <= last and first < size else None
