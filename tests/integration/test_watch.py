"""A run is watched and acted on over HTTP: by an operator's key, with a simulator that is killed, in either clock."""

import http.client
import json
import os
import re
import shutil
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from dynpf_formats.recording.reader import read_recording
from dynpf_services.scenario.played_log import acts_of

from tests.integration.conftest import Start, Told
from tests.integration.processes import Child, processes_of, until

pytestmark = pytest.mark.timeout(300)


class Browser:
    """One who looks on, and acts."""

    def __init__(self, address: str) -> None:
        self._url = urlsplit(address)
        assert self._url.hostname is not None
        self._host: str = self._url.hostname
        self.events: list[tuple[str, Any]] = []
        self._stream = http.client.HTTPConnection(self._host, self._url.port)
        self._stream.request("GET", f"{self._url.path}events")
        threading.Thread(target=self._read, args=(self._stream.getresponse(),), daemon=True).start()

    def _read(self, response: http.client.HTTPResponse) -> None:
        name = ""
        for line in response:
            if line.startswith(b"event: "):
                name = line[7:].strip().decode()
            elif line.startswith(b"data: "):
                self.events.append((name, json.loads(line[6:])))

    def ask(self, **wish: Any) -> int:
        """Ask for something, and return the status of the answer."""
        link = http.client.HTTPConnection(self._host, self._url.port)
        headers = {"Content-Type": "application/json", "Origin": f"http://{self._url.netloc}"}
        link.request("POST", f"{self._url.path}act", json.dumps(wish), headers)
        status = link.getresponse().status
        link.close()
        return status

    def said(self, text: str) -> None:
        """Wait until the page is told a text."""
        until(lambda: [data for name, data in [*self.events] if name == "said" and text in data["text"]], text)

    def shows(self, found: Callable[[dict[str, Any]], bool], what: str) -> None:
        """Wait until a frame is as it should be."""
        until(lambda: any(found(data) for name, data in self.events[-5:] if name == "frame"), what)


def page_of(run: Child) -> Browser:
    run.says("live page: http://127.0.0.1:")
    return Browser(re.findall(r"live page: (\S+)", run.stderr)[0])


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_person_acts_before_and_after_the_simulator_is_killed(
    clock: str, tmp_path: Path, dynpf: Start, here: Callable[..., Told]
) -> None:
    path = tmp_path / "run.mcap"
    run = dynpf("run", "landmark-room", "--clock", clock, "--watch", "--no-page", "-o", path)
    browser = page_of(run)
    browser.shows(lambda frame: frame["tick"] > 5, "the run goes on")
    assert browser.ask(topic="operator/place", act={"x": 1.0, "y": 0.5, "theta": 0.0}) == 200
    browser.said("operator/place: x 1.0, y 0.5")
    assert browser.ask(pace={"paused": True}) == 200
    browser.said("has paused the run")
    (simulator,) = [process for process in processes_of(tmp_path) if process.service == "simulator"]
    os.kill(simulator.pid, signal.SIGKILL)
    run.says("simulator is back")
    browser.shows(lambda frame: frame["state"]["paused"], "it is told again to pause")
    assert browser.ask(pace={"paused": False}) == 200
    browser.said("lets the run go on")
    assert browser.ask(topic="operator/place", act={"x": -1.0, "y": 0.5, "theta": 0.0}) == 200
    browser.said("operator/place: x -1.0, y 0.5")
    run.interrupt()
    assert run.wait() == 0, run.stderr
    assert browser.events[-1][0] == "end"
    acts = acts_of(read_recording(path))
    assert [json.loads(act.payload)["x"] for of_tick in acts.values() for act in of_tick] == [1.0, -1.0]
    assert json.loads(here("replay", path, "--json").out)["same"]


def test_by_an_observers_key_one_looks_on_only_and_who_stops_is_another_operator(tmp_path: Path, dynpf: Start) -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts what it does not wait for
    run = dynpf("run", "landmark-room", "--watch", "--no-page", "-o", tmp_path / "run.mcap")
    signal.signal(signal.SIGINT, before)
    operator = page_of(run)
    found = re.search(r"--connect (\S+) --keys (\S+)", run.stderr)
    assert found is not None
    endpoint, guests = found[1], Path(found[2])
    own = tmp_path / "own"
    own.mkdir(mode=0o700)
    for name in ("ca.pem", "observer.pem", "observer.key"):
        shutil.copy(guests / name, own / name)
    view = dynpf("view", "--live", "--connect", endpoint, "--keys", own, "--no-open", guests.parent)
    until(lambda: view.stdout.endswith("/\n") or view.popen.poll() is not None, "its address")
    observer = Browser(view.stdout.strip())
    observer.shows(lambda frame: frame["tick"] > 5, "it follows the run")
    assert observer.ask(topic="operator/place", act={"x": 1.0, "y": 0.5, "theta": 0.0}) == 403
    assert operator.ask(topic="operator/place", act={"x": 9e9, "y": 0.5, "theta": 0.0}) == 400
    stop = dynpf("stop", "--connect", endpoint, "--keys", guests)
    assert stop.wait() == 0, (stop.stderr, run.stderr)
    until(lambda: observer.events[-1][0] == "end", "it says that the run has ended")
    view.interrupt()
    assert view.wait() == 0, view.stderr
    run.says("the live page is still open in a browser; Ctrl-C ends it")
    assert "digest" in run.stdout
    run.interrupt()
    assert run.wait() == 0, run.stderr


def test_what_cannot_be_watched_is_said(here: Callable[..., Told]) -> None:
    inline = here("run", "landmark-room", "--runner", "inline", "--watch")
    assert (inline.code, "needs --runner bus" in inline.err) == (2, True)
    assert here("run", "landmark-room", "--watch-port", "1234").code == 2
    assert here("run", "landmark-room", "--speed", "-1").code == 2
    assert "does nothing without --live" in here("view", "RUN.mcap", "--connect", "tcp/127.0.0.1:1").err
    assert here("view").code == 2
