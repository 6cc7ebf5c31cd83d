"""Why a router refuses a process, by a handshake of OpenSSL's with a server of its own."""

import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from dynpf_runtime.bus.keys import init, issue, load
from dynpf_runtime.bus.probe import refusal


@contextmanager
def listening(folder: Path) -> Iterator[str]:
    """Have somebody shake hands once with the router's key in ``folder``, at the endpoint that this gives."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "router.pem", folder / "router.key")
    context.load_verify_locations(folder / "ca.pem")
    context.verify_mode = ssl.CERT_REQUIRED
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            link, _ = server.accept()
            try:
                with context.wrap_socket(link, server_side=True) as shaken:
                    shaken.recv(1)
            except OSError:
                link.close()

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"tls/127.0.0.1:{server.getsockname()[1]}"
        thread.join()


@pytest.mark.parametrize(
    ("hosts", "told"),
    [
        (["127.0.0.1"], ""),
        (
            ["robot.local"],
            "has a certificate for another host than 127.0.0.1; issue it with: dynpf keys issue router --host",
        ),
    ],
)
def test_a_router_of_another_host_is_told_apart_from_one_of_another_authority(
    tmp_path: Path, hosts: list[str], told: str
) -> None:
    now = datetime.now(UTC)
    init(tmp_path / "keys", now)
    issue(tmp_path / "keys", ["router", "sensors"], now, hosts=hosts)
    with listening(tmp_path / "keys") as endpoint:
        said = refusal(endpoint, load(tmp_path / "keys", "sensors", now))
    assert said.startswith(told) and bool(said) == bool(told)
