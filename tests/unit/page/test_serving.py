"""Files for a viewer in the browser: whole or in ranges, to its page alone, under an address that nobody guesses."""

from collections.abc import Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from threading import Thread

import pytest
from dynpf_lab.serving.files import FileServer

PAGE = "https://viewer.example"
DATA = bytes(range(256)) * 10


@pytest.fixture
def server(tmp_path: Path) -> Iterator[FileServer]:
    path = tmp_path / "run.mcap"
    path.write_bytes(DATA)
    with FileServer({"run.mcap": path}, PAGE) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(server: FileServer, method: str = "GET", path: str | None = None, **headers: str) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", server.server_port)
    connection.request(method, path or f"/{server.token}/run.mcap", headers=headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


@pytest.mark.parametrize(
    ("asked", "first", "last"),
    [("bytes=0-99", 0, 99), ("bytes=2500-", 2500, 2559), ("bytes=-10", 2550, 2559), ("bytes=2550-9999", 2550, 2559)],
)
def test_ranges_are_those_of_the_file(server: FileServer, asked: str, first: int, last: int) -> None:
    answer, content = ask(server, Range=asked, Origin=PAGE)
    assert (answer.status, content) == (206, DATA[first : last + 1])
    assert answer.headers["Content-Range"] == f"bytes {first}-{last}/{len(DATA)}"
    assert answer.headers["Access-Control-Allow-Origin"] == PAGE


def test_the_whole_file_and_its_size_are_told(server: FileServer) -> None:
    answer, content = ask(server, Origin=PAGE)
    assert (answer.status, content) == (200, DATA)
    answer, content = ask(server, "HEAD", Origin=PAGE)
    assert (answer.status, content, answer.headers["Content-Length"]) == (200, b"", str(len(DATA)))
    assert answer.headers["Accept-Ranges"] == "bytes"


def test_a_browser_is_told_what_the_page_may_ask_for(server: FileServer) -> None:
    answer, _ = ask(server, "OPTIONS", Origin=PAGE)
    assert answer.status == 204
    assert answer.headers["Access-Control-Allow-Headers"] == "Range"
    assert answer.headers["Access-Control-Allow-Private-Network"] == "true"


@pytest.mark.parametrize("asked", ["bytes=2560-", "bytes=5-3", "bytes=-", "bytes=-0", "lines=1-2", "bytes=0-1,3-4"])
def test_ranges_that_are_none_are_refused(server: FileServer, asked: str) -> None:
    answer, content = ask(server, Range=asked)
    assert (answer.status, content) == (416, b"")
    assert answer.headers["Content-Range"] == f"bytes */{len(DATA)}"


@pytest.mark.parametrize("path", ["/run.mcap", "/wrong/run.mcap", "/{token}/other", "/{token}/../run.mcap", "/"])
def test_who_does_not_know_the_address_gets_nothing(server: FileServer, path: str) -> None:
    answer, content = ask(server, path=path.replace("{token}", server.token))
    assert (answer.status, content) == (404, b"")


@pytest.mark.parametrize("headers", [{"Origin": "https://other.example"}, {"Host": "evil.example"}])
def test_other_pages_and_other_names_are_refused(server: FileServer, headers: dict[str, str]) -> None:
    answer, content = ask(server, **headers)
    assert (answer.status, content) == (403, b"")
