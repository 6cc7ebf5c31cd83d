"""``dynpf view --live``: a page on this machine that follows a run on the bus, and by which its operator acts on it."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import RunError, UsageError

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.going import scenario_of, target_of

if TYPE_CHECKING:
    from dynpf_protocol.control import Recorded
    from dynpf_runtime.bus.keys import Credentials
    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.bus.terminal import StopSignal

    from dynpf_lab.live.server import Page

__all__ = ["run_live"]

PAGE_S = 120.0
"""How long the finished page may take to be there after the end of the run."""

TELL_S = 2.0
LOOK_S = 0.1


def run_live(options: argparse.Namespace) -> int:
    """Serve the page of a run until it is over and nobody looks on, and return the exit code."""
    import os

    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.bus.terminal import StopSignal, say
    from dynpf_services.scenario.build import plan_of

    from dynpf_lab.cli.view import open_browser
    from dynpf_lab.live.server import serving
    from dynpf_lab.live.setting import live_page
    from dynpf_lab.live.watching import come_second

    if options.other is not None or options.output is not None:
        raise UsageError("--live: shows one run, and writes no page; dynpf view RUN.mcap makes one of its recording")
    target = target_of(options)
    endpoint, (keys, acts) = endpoint_of(options), _credentials(options)
    come_second()
    parent = os.getppid() if options.beside_run else None
    with (
        StopSignal.installed(parent) as stop,
        Bus.connect(endpoint, lambda text: say("view", text), lambda: stop.requested, keys) as bus,
    ):
        text = _scenario_text(bus, endpoint, stop)
        scenario = scenario_of(target, text, endpoint, options.allow_code, "the page")
        plan = plan_of(scenario)
        if plan.text != text:
            raise UsageError(f"the run at {endpoint} is of another scenario, or its modules have other sources there")
        page, watching = live_page(scenario, plan, acts=acts)
        with serving(page, options.port) as server:
            if options.beside_run:
                say("run", f"live page: {server.address}")
            else:
                print(server.address, flush=True)
                if not options.no_open:
                    open_browser(server.address)
            watching.begin(bus)
            watching.follow(bus, lambda: stop.requested)
            watching.show()
            _see_off(page, watching.ended, options, stop)
    return 0


def _credentials(options: argparse.Namespace) -> "tuple[Credentials | None, bool]":
    """Return the credentials of an operator, or else of an observer, and whether one may act by them."""
    if options.keys is None:
        return None, True
    try:
        return credentials_of(options, "operator", quiet=True), True
    except UsageError:
        return credentials_of(options, "observer", quiet=True), False


def _scenario_text(bus: "Bus", endpoint: str, stop: "StopSignal") -> str:
    """Return the scenario of the run by its router."""
    from dynpf_protocol.keys import SCENARIO

    while (answer := bus.ask(SCENARIO)) is None:
        if stop.requested:
            raise KeyboardInterrupt
        if not bus.connected:
            raise RunError(f"the router at {endpoint} is gone")
        time.sleep(LOOK_S)
    return answer.decode(errors="replace")


def _see_off(page: "Page", recorded: "Recorded | None", options: argparse.Namespace, stop: "StopSignal") -> None:
    """Tell browsers that the run is over and where its page is, and wait for them to leave."""
    from dynpf_runtime.bus.terminal import say

    from dynpf_lab.page import page_of

    end = {"complete": False, "reason": "the run is gone"}
    path: Path | None = None
    if recorded is not None:
        end = {"complete": recorded.complete, "reason": recorded.reason}
        recording = Path(recorded.path)
        path = page_of(recording) if recording.is_file() and not options.no_page else None
    page.audience.end({**end, "page": "none" if path is None else "waits"})
    began_s, since, told = time.monotonic(), time.time(), False
    while len(page.audience) and not stop.requested:
        passed_s = time.monotonic() - began_s
        if path is not None and (_is_new(path, since) or passed_s > PAGE_S):
            page.finished, path = path if passed_s <= PAGE_S else None, None
            page.audience.end({**end, "page": "none" if page.finished is None else "there"})
        if not told and path is None and passed_s > TELL_S:
            told = True
            say("run" if options.beside_run else "view", "the live page is still open in a browser; Ctrl-C ends it")
        time.sleep(LOOK_S)


def _is_new(path: Path, since: float) -> bool:
    """Return whether a page was written after a time, about when its run ended."""
    try:
        return path.stat().st_mtime > since - 2.0
    except OSError:
        return False
