"""The server of a live page answers its own page alone, acts only as it is asked to, and is held up by nobody."""

import http.client
import socket
import threading
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from dynpf_lab.live.audience import MOST_SAID, MOST_SEATS, Audience
from dynpf_lab.live.server import Page, Server, serving
from dynpf_lab.live.wishes import MOST_BYTES, checked
from dynpf_protocol.control import Pace
from dynpf_protocol.errors import BadMessageError
from dynpf_protocol.topics import TOPICS
from hypothesis import given
from hypothesis import strategies as st

ACTS = {name: TOPICS[name] for name in ("operator/place", "operator/drive")}
PLACE = b'{"topic":"operator/place","act":{"x":1,"y":2,"theta":0}}'


class Served(NamedTuple):
    """A server, its audience, and what it was asked to do."""

    server: Server
    audience: Audience
    asked: list[bytes]


@pytest.fixture(name="served")
def a_served_page() -> Iterator[Served]:
    audience, asked = Audience({"title": "t"}), list[bytes]()

    def act(body: bytes) -> None:
        checked(body, ACTS)
        asked.append(body)

    with serving(Page("<p>live</p>", "default-src 'none'", audience, act)) as server:
        yield Served(server, audience, asked)


def answer(
    served: Served, method: str, path: str, body: bytes = b"", **headers: str | None
) -> tuple[int, str, http.client.HTTPMessage]:
    """Return status, text and headers of an answer; a header that is None is left out."""
    server = served.server
    usual = {"Host": f"127.0.0.1:{server.port}", "Content-Type": "application/json", "Content-Length": str(len(body))}
    usual["Origin"] = f"http://127.0.0.1:{server.port}"
    if method == "GET":
        del usual["Origin"]
    given = {**usual, **{name.replace("_", "-"): value for name, value in headers.items()}}
    link = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    link.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    for name, value in given.items():
        if value is not None:
            link.putheader(name, value)
    link.endheaders(body)
    response = link.getresponse()
    text = "" if response.headers["Content-Type"] == "text/event-stream" else response.read().decode()
    link.close()
    return response.status, text, response.headers


def own(served: Served, name: str = "") -> str:
    return f"/{served.server.token}/{name}"


def test_the_page_comes_with_its_policy_and_the_acts_of_the_page_are_taken(served: Served) -> None:
    status, text, headers = answer(served, "GET", own(served))
    assert (status, text) == (200, "<p>live</p>")
    assert headers["Content-Security-Policy"] == "default-src 'none'"
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    assert answer(served, "POST", own(served, "act"), PLACE)[:2] == (200, "{}")
    assert served.asked == [PLACE]


@pytest.mark.parametrize(
    ("method", "name", "headers", "status"),
    [
        ("GET", "", {"Host": "evil.example"}, 421),
        ("GET", "", {"Host": "evil.example:80"}, 421),
        ("GET", "", {"Host": None}, 421),
        ("GET", "events", {"Origin": "http://evil.example"}, 403),
        ("GET", "events", {"Sec_Fetch_Site": "cross-site"}, 403),
        ("GET", "events", {"Sec_Fetch_Site": "same-site"}, 403),
        ("POST", "act", {"Origin": None}, 403),
        ("POST", "act", {"Origin": "null"}, 403),
        ("POST", "act", {"Origin": "http://evil.example"}, 403),
        ("POST", "act", {"Origin": "http://127.0.0.1:1"}, 403),
        ("POST", "act", {"Sec_Fetch_Site": "cross-site"}, 403),
        ("POST", "act", {"Host": "evil.example"}, 421),
        ("POST", "act", {"Content_Type": "text/plain"}, 415),
        ("POST", "act", {"Content_Length": str(MOST_BYTES + 1)}, 413),
        ("POST", "act", {"Content_Length": "-1"}, 413),
        ("POST", "", {}, 404),
        ("GET", "run.html", {}, 404),
        ("GET", "../act", {}, 404),
    ],
)
def test_what_does_not_come_from_the_page_is_refused(
    served: Served, method: str, name: str, headers: dict[str, str | None], status: int
) -> None:
    body = PLACE if method == "POST" else b""
    assert answer(served, method, own(served, name), body, **headers)[0] == status
    assert served.asked == []
    assert len(served.audience) == 0


@pytest.mark.parametrize("path", ["/", "/events", "/wrong/", "/wrong/act", "//act", "/%00/", "/é/"])
def test_without_the_token_there_is_nothing(served: Served, path: str) -> None:
    for method in ("GET", "POST"):
        try:
            status = answer(served, method, path, PLACE if method == "POST" else b"")[0]
        except UnicodeEncodeError:  # a client that keeps to the rules does not send it
            return
        assert status == 404
    assert served.asked == []


def test_who_only_looks_on_cannot_act() -> None:
    audience = Audience({})
    with serving(Page("", "", audience, None)) as server:
        assert answer(Served(server, audience, []), "POST", f"/{server.token}/act", PLACE)[0] == 403


def read_events(link: socket.socket, count: int) -> list[str]:
    """Return the names of the first events of a stream."""
    with link.makefile("rb") as lines:
        names = (line[7:].strip().decode() for line in lines if line.startswith(b"event: "))
        return [next(names) for _ in range(count)]


def look(served: Served) -> socket.socket:
    link = socket.create_connection(("127.0.0.1", served.server.port), 10)
    link.sendall(f"GET {own(served, 'events')} HTTP/1.1\r\nHost: 127.0.0.1:{served.server.port}\r\n\r\n".encode())
    return link


def test_ten_browsers_see_frames_while_one_takes_nothing(served: Served) -> None:
    audience = served.audience
    stalled, links = look(served), [look(served) for _ in range(10)]
    seen: list[list[str]] = [[] for _ in links]
    stop = threading.Event()

    def show() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            audience.show({"number": number, "much": "x" * 200_000}, {"stays": 1})
            stop.wait(0.001)

    threads = [
        threading.Thread(target=lambda at=at, link=link: seen[at].extend(read_events(link, 40)))
        for at, link in enumerate(links)
    ]
    showing = threading.Thread(target=show)
    for thread in (*threads, showing):
        thread.start()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    stop.set()
    showing.join(10)
    for events in seen:
        assert events[:3] == ["begin", "stays", "frame"]
        assert set(events[3:]) == {"frame"}
    for link in (stalled, *links):
        link.close()


def test_of_frames_the_newest_waits_and_of_texts_the_last() -> None:
    audience = Audience({})
    seat = audience.enter()
    assert seat is not None
    for number in range(3 * MOST_SAID):
        audience.show({"frame": number}, {})
        audience.say({"n": number})
    told = (audience.next(seat, 0.0) or b"").decode()
    assert told.count("event: frame") == 1
    assert f'{{"frame":{3 * MOST_SAID - 1}}}' in told
    assert told.count("event: said") == MOST_SAID
    assert audience.next(seat, 0.0) == b""
    audience.end({"reason": "over"})
    assert b"event: end" in (audience.next(seat, 0.0) or b"")
    audience.close()
    assert audience.next(seat, 0.0) is None


def test_there_are_so_many_seats_and_no_more() -> None:
    audience = Audience({})
    seats = [audience.enter() for _ in range(MOST_SEATS)]
    assert None not in seats
    assert audience.enter() is None
    seat = seats[0]
    assert seat is not None
    audience.leave(seat)
    assert audience.enter() is not None


def test_a_wish_is_typed_and_within_its_range() -> None:
    assert checked(PLACE, ACTS).topic == "operator/place"
    assert checked(b'{"pace":{"paused":true,"steps":3,"rate":2}}', ACTS).pace == Pace(paused=True, steps=3, rate=2.0)
    for body in (
        b"",
        b"[]",
        b'{"topic":"truth/robot","act":{"x":0,"y":0,"theta":0}}',
        b'{"topic":"operator/place"}',
        b'{"topic":"operator/place","act":{"x":1e999,"y":0,"theta":0}}',
        b'{"topic":"operator/place","act":{"x":1e8,"y":0,"theta":0}}',
        b'{"topic":"operator/place","act":{"x":null,"y":0,"theta":0}}',
        b'{"topic":"operator/place","act":{"x":0,"y":0,"theta":0,"z":0}}',
        b'{"topic":"operator/place","act":{"x":0,"y":0,"theta":0},"pace":{"paused":true}}',
        b'{"pace":{"rate":-1}}',
        b'{"pace":{"rate":1e9}}',
        b'{"pace":{"steps":1000000}}',
        b'{"topic":"operator/drive","act":{"lasts_s":0}}',
    ):
        with pytest.raises(BadMessageError):
            checked(body, ACTS)


@given(st.binary(max_size=300))
def test_no_body_does_more_than_be_refused(body: bytes) -> None:
    with pytest.raises(BadMessageError):
        checked(body, ACTS)
