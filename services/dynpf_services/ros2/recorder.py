"""Records what is heard at a robot's router into a capture; a router that is not there, or goes, is waited for."""

import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh
from dynpf_formats.capture.form import Began, Dropped, Ended, Outage
from dynpf_formats.capture.tally import Tally
from dynpf_formats.capture.writer import CaptureWriter
from dynpf_formats.ros2.attachment import Attachment
from dynpf_formats.ros2.keys import Qos
from dynpf_runtime.bus.terminal import StopSignal, say

from dynpf_services.ros2.client import NoRouterError, router_session
from dynpf_services.ros2.hearing import Drops, Ears, Heard

if TYPE_CHECKING:
    from dynpf_formats.ros2.types import Releases  # needs rosbags

__all__ = ["record"]

_FLUSH_S = 1.0
_POLL_S = 0.2
_AT_ONCE = 200  # messages that are written between two looks at clock and router


def record(
    began: Began,
    keys: Sequence[zenoh.KeyExpr],
    releases: "Releases | None",
    path: Path,
    *,
    stop: StopSignal,
    duration_s: float | None,
) -> tuple[Tally, Ended]:
    """Record ``keys`` into the new file ``path`` until the user stops it, or ``duration_s`` after the router is there.

    Returns what was recorded. Raises RecordingError if the file cannot be written.
    """
    wake = threading.Event()
    stop.wakes(wake.set)
    heard: list[Ears] = []

    def qos_of(topic: str) -> Qos | None:
        return heard[0].qos_of(topic) if heard else None

    writer = CaptureWriter(path, began, releases, qos_of)
    try:
        with ExitStack() as stack:
            session = _joined(began.connect, stop, wake, stack)
            if session is None:
                writer.tally.outages.append(Outage(began.began_ns, 0))
                return writer.tally, writer.close(f"{stop.reason}; no router was there", time.time_ns())
            ears = Ears(session, keys, began.domain, ros=releases is not None, wake=wake.set)
            heard.append(ears)
            say("record", f"records {', '.join(began.keys)} of {began.connect} into {path}; Ctrl-C ends it")
            recorder = _Recorder(writer, ears)
            recorder.run(stop, wake, None if duration_s is None else time.monotonic() + duration_s)
        recorder.finish(stop)
        reason = stop.reason or f"the {duration_s:g} s are over"
        return writer.tally, writer.close(reason, time.time_ns())
    finally:
        writer.release()


def _joined(endpoint: str, stop: StopSignal, wake: threading.Event, stack: ExitStack) -> zenoh.Session | None:
    """Return a session with the router as soon as there is one, None once the user has stopped it.

    It is opened in another thread: where nobody answers that takes a while, in which a signal is heard.
    """
    told = False
    while not stop.requested:
        found: list[zenoh.Session | NoRouterError] = []
        opened = ExitStack()

        def attempt(found: list[zenoh.Session | NoRouterError] = found, opened: ExitStack = opened) -> None:
            try:
                found.append(opened.enter_context(router_session(endpoint)))
            except NoRouterError as error:
                found.append(error)
            wake.set()

        threading.Thread(target=attempt, daemon=True).start()
        began = time.monotonic()
        while not stop.requested and not found:
            wake.wait(_POLL_S)
            wake.clear()
            if not found and not told and time.monotonic() - began > 1.0:
                say("record", f"waits for the router at {endpoint}")
                told = True
        if found and isinstance(found[0], zenoh.Session):
            stack.enter_context(opened)
            return found[0]
        if found and not told:
            say("record", f"waits for the router: {found[0]}")
            told = True
        if not stop.requested:
            wake.wait(_POLL_S)
    return None


class _Recorder:
    """Writes what is heard, hands it on in time, and watches the router."""

    def __init__(self, writer: CaptureWriter, ears: Ears) -> None:
        self._writer, self._ears = writer, ears
        self._told = 0
        self._full = False
        self._router = ears.router()
        self._seen_ns = time.time_ns()  # when the router was there for the last time

    def run(self, stop: StopSignal, wake: threading.Event, until: float | None) -> None:
        """Record until the user stops it or the time is over."""
        flushed = time.monotonic()
        while not stop.requested and (until is None or time.monotonic() < until):
            wake.clear()
            self._ears.announce()  # a publisher's token comes before its messages
            written = self._write(_AT_ONCE)
            self._watch()
            self._tell()
            if time.monotonic() - flushed >= _FLUSH_S:
                self._writer.flush()
                flushed = time.monotonic()
            if not written:
                wake.wait(_POLL_S if until is None else max(0.0, min(_POLL_S, until - time.monotonic())))

    def finish(self, stop: StopSignal) -> None:
        """Write what still waits; a second signal ends that, and what is left counts as dropped."""
        while not stop.at_once and self._write(_AT_ONCE):
            pass
        while (heard := self._ears.take()) is not None:
            self._drop(heard)
        if not self._router:
            self._writer.tally.outages.append(Outage(self._seen_ns, 0))
        self._tell()

    def _write(self, most: int) -> int:
        for count in range(most):
            heard = self._ears.take()
            if heard is None:
                return count
            if isinstance(heard, Drops):
                self._drop(heard)
            else:
                self._writer.write(heard)
        return most

    def _drop(self, heard: Heard) -> None:
        if not self._full:
            self._full = True
            say("record", "more comes than can be written here; what has no room is left out, and counted")
        if isinstance(heard, Drops):
            for dropped in heard.dropped:
                self._writer.drop(dropped)
            return
        self._writer.drop(Dropped.of(heard.key, Attachment.found(heard.attachment), heard.arrival_ns))

    def _watch(self) -> None:
        """Note when the router goes, and when it or another comes back."""
        router, now_ns = self._ears.router(), time.time_ns()
        if not router and self._router:
            say("record", "the router is gone; waits for it")
        elif router and router != self._router:
            say("record", "the router is back")
            self._writer.tally.outages.append(Outage(self._seen_ns, now_ns))
        self._router = router
        if router:
            self._seen_ns = now_ns

    def _tell(self) -> None:
        for text in self._writer.notices[self._told :]:
            say("record", text)
        self._told = len(self._writer.notices)
