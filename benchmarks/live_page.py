"""Whether who watches a run by its live page slows it down, and how soon what a person does is in the run.

python benchmarks/live_page.py [--scenario NAME] [--rounds N] [--seconds S] [--browsers N]

One run goes as fast as it can, with ``--watch``. In turns nobody looks on, and ten browsers do and one that takes
nothing of what it is sent; ticks are counted by the recording's publish times. Their ratio is of the medians over the
rounds. A browser is a connection that reads and parses what it is sent. Then a run at the speed of a clock has a robot
carried again and again: from the request to the message of the tick that has it, by this machine's clock.

``--unwatched`` has runs without ``--watch`` between such with it, and tells the ratio of those, too.
"""

import argparse
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dynpf_formats.recording.reader import read_recording

from dynpf.types import FloatArray

BEGIN_S = 1.0
"""How long what was changed may take to have its effect."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="landmark-room")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each turn")
    parser.add_argument("--browsers", type=int, default=10)
    parser.add_argument("--acts", type=int, default=20)
    parser.add_argument("--unwatched", type=int, default=0, metavar="N", help="pairs of runs with and without --watch")
    options = parser.parse_args()
    print(json.dumps(rates(options.scenario, options.rounds, options.seconds, options.browsers)))
    print(json.dumps(delays(options.scenario, options.acts)))
    if options.unwatched:
        print(json.dumps(unwatched(options.scenario, options.unwatched, options.seconds)))


@contextmanager
def watched(scenario: str, path: Path, *words: str) -> Iterator[tuple[str, int]]:
    """Run a scenario with --watch while the block lasts; yield the page's address and the run's process."""
    with started(scenario, path, "--watch", *words) as run:
        assert run.stderr is not None
        told = ""
        while (found := re.search(r"live page: (http://\S+)", told)) is None:
            told += run.stderr.readline().decode()
        threading.Thread(target=run.stderr.read, daemon=True).start()
        yield found[1], run.pid


@contextmanager
def started(scenario: str, path: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a scenario for as long as the block lasts, then stop it."""
    command = [sys.executable, "-m", "dynpf_lab.cli.main", "run", scenario, "-o", str(path), "--no-page", *words]
    more = ["--set", "max_ticks=1000000", "--set", "controller.laps=1000"]
    with subprocess.Popen([*command, *more], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        yield run
        run.send_signal(signal.SIGINT)
        run.wait()


def processor_s(run: int) -> tuple[float, float]:
    """Return what a run's processes have taken of the processor so far, and what its page's server has, s."""
    found = [0.0, 0.0]
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
            words = entry.with_name("cmdline").read_bytes()
        except OSError:  # it has ended
            continue
        if int(fields[1]) == run:
            found[b"--live" in words] += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return found[0], found[1]


def connected(address: str) -> socket.socket:
    """Return a connection of a browser that has asked for the events of a page."""
    host, port, token = parts_of(address)
    link = socket.create_connection((host, port))
    link.sendall(f"GET /{token}/events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    return link


def parts_of(address: str) -> tuple[str, int, str]:
    found = re.fullmatch(r"http://([^:]+):(\d+)/([^/]+)/", address)
    assert found is not None
    return found[1], int(found[2]), found[3]


@contextmanager
def looking_on(address: str, browsers: int) -> Iterator[list[int]]:
    """Have so many browsers look on, and one that takes nothing; yield how many frames each has got so far."""
    links = [connected(address) for _ in range(browsers)]
    stalled = connected(address)
    frames = [0] * browsers

    def read(number: int) -> None:
        with suppress(OSError), links[number].makefile("rb") as lines:
            for line in lines:
                if line.startswith(b'data: {"t"'):
                    json.loads(line[6:])
                    frames[number] += 1

    threads = [threading.Thread(target=read, args=(number,), daemon=True) for number in range(browsers)]
    for thread in threads:
        thread.start()
    try:
        yield frames
    finally:
        for link in (*links, stalled):
            link.shutdown(socket.SHUT_RDWR)
            link.close()


class Turn(NamedTuple):
    """A time in which browsers looked on, or none did, and what the run and the page's server took in it, s."""

    looked_on: bool
    begin_s: float
    end_s: float
    run_s: float
    page_s: float


def rates(scenario: str, rounds: int, seconds: float, browsers: int) -> dict[str, float]:
    """Return the ticks a second of one run with and without browsers that look on, and how many frames these got."""
    turns: list[Turn] = []
    shown = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with watched(scenario, path, "--speed", "0") as (address, run):

            def turn(looked_on: bool) -> None:
                begin_s, before = time.time(), processor_s(run)
                time.sleep(seconds)
                after = processor_s(run)
                turns.append(Turn(looked_on, begin_s, time.time(), after[0] - before[0], after[1] - before[1]))

            time.sleep(5 * BEGIN_S)
            with looking_on(address, 1):  # from the first browser on the server listens to the run
                time.sleep(BEGIN_S)
            for _ in range(rounds):
                time.sleep(BEGIN_S)
                turn(False)
                with looking_on(address, browsers) as frames:
                    time.sleep(BEGIN_S)
                    before = sum(frames)
                    turn(True)
                    shown += (sum(frames) - before) / (seconds * browsers * rounds)
        recording = read_recording(path)
        published = np.array([record.publish_ns for record in recording.messages("truth/robot")]) * 1e-9
    alone, shared = (measured([each for each in turns if each.looked_on is on], published) for on in (False, True))
    return {
        "ticks_per_s_alone": alone[0],
        "ticks_per_s_with_browsers": shared[0],
        "ratio": shared[0] / alone[0],
        "processor_ms_per_tick_alone": alone[1],
        "processor_ms_per_tick_with_browsers": shared[1],
        "processor_ratio": shared[1] / alone[1],
        "page_processor_share": shared[2],
        "frames_per_s_and_browser": shown,
    }


def measured(turns: list[Turn], published: FloatArray) -> tuple[float, float, float]:
    """Return ticks a second, the run's processor time a tick, ms, and the server's share of a core: medians."""
    ticks = [int(np.sum((published >= each.begin_s) & (published < each.end_s))) for each in turns]
    rows = [
        (count / (each.end_s - each.begin_s), 1e3 * each.run_s / count, each.page_s / (each.end_s - each.begin_s))
        for count, each in zip(ticks, turns, strict=True)
    ]
    rate, processor, share = np.median(np.array(rows), axis=0).tolist()
    return rate, processor, share


def delays(scenario: str, acts: int) -> dict[str, float]:
    """Return how long it takes from the request to carry a robot until it is there, s."""
    asked: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with watched(scenario, path) as (address, _):
            host, port, token = parts_of(address)
            time.sleep(5 * BEGIN_S)
            for number in range(acts):
                time.sleep(0.37)
                act = {"x": 0.1 * (number % 9), "y": 0.1, "theta": 0.0}
                link = http.client.HTTPConnection(host, port)
                headers = {"Content-Type": "application/json", "Origin": f"http://{host}:{port}"}
                asked.append(time.time())
                link.request("POST", f"/{token}/act", json.dumps({"topic": "operator/place", "act": act}), headers)
                assert link.getresponse().status == http.HTTPStatus.OK
                link.close()
            time.sleep(BEGIN_S)
        recording = read_recording(path)
        placed = [record.publish_ns * 1e-9 for record in recording.messages("operator/place")]
        found = [there - then for then, there in zip(asked, placed, strict=True)]
    return {"act_median_s": float(np.median(found)), "act_greatest_s": max(found)}


def unwatched(scenario: str, pairs: int, seconds: float) -> dict[str, float]:
    """Return the ticks a second of runs with --watch, on which nobody looks, over those of runs without."""
    found: dict[bool, list[float]] = {False: [], True: []}
    for number in range(2 * pairs):
        watch = bool(number % 2)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.mcap"
            with started(scenario, path, "--speed", "0", *(["--watch"] if watch else [])):
                while not path.exists():
                    time.sleep(0.05)
                time.sleep(5 * BEGIN_S + seconds)
            published = np.array([record.publish_ns for record in read_recording(path).messages("truth/robot")]) * 1e-9
            last = published[published > published[-1] - seconds]
            found[watch].append(len(last) / seconds)
    without, with_it = (float(np.median(found[watch])) for watch in (False, True))
    return {"ticks_per_s": without, "ticks_per_s_watched": with_it, "ratio_watched": with_it / without}


if __name__ == "__main__":
    main()
