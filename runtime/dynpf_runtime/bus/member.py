"""Membership: how a process joins a run, knows its peers, beats, and learns that somebody is gone.

A process joins in two steps: *alive* when its subscriptions stand, *ready* when it has seen every peer alive. The
source begins when all are ready, so no message can precede its subscribers, and every sender is known by its boot.
"""

import os
import signal
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from dynpf_protocol.control import Beat, Recorded, Stop, decode_control, encode_control
from dynpf_protocol.errors import BrokenOffError, ProtocolError, RunError, UsageError

from dynpf_runtime.bus.agreement import first_difference
from dynpf_runtime.bus.session import ALIVE, BEAT, CONTROL, READY, SCENARIO, Arrival, Bus
from dynpf_runtime.plan import Plan

__all__ = ["Member", "join", "new_boot", "say"]

BEAT_S = 0.5
WEDGED_S = 15.0
SURE_S = 0.05
"""When the router goes, the peers' tokens go first: a moment later it is clear who it was."""
RECORDER = "recorder"


def new_boot() -> str:
    """Return a name for this start of a process."""
    return uuid.uuid4().hex[:12]


def say(name: str, text: str) -> None:
    """Tell the person at the terminal."""
    print(f"dynpf {name}: {text}", file=sys.stderr, flush=True)


class Member:
    """This process's place in the run. ``poll`` is the heart of every main loop."""

    def __init__(self, name: str, bus: Bus, plan: Plan, boot: str, stop: "StopSignal") -> None:
        self.name = name
        self.bus = bus
        self.boot = boot
        self.peers = {*plan.graph.nodes, RECORDER} - {name}
        self.boots: dict[str, str] = {}
        self.ticks = 0
        self.recorded: Recorded | None = None
        self.stop_reason = ""
        self.leaving = False  # the run is over: peers may go
        self._stop = stop
        self._stop_sent = False
        self._ready: set[str] = set()
        self._early: deque[Arrival] = deque()
        self._beats: dict[str, float] = {}
        self._peer_ticks: dict[str, int] = {}
        self._next_beat = 0.0

    def poll(self, timeout_s: float = BEAT_S) -> Arrival | None:
        """Beat if it is time, and return the next arrival that is not about membership, or None.

        Raises RunError when a peer or the router is gone, and KeyboardInterrupt when this process shall stop at once.
        """
        now = time.monotonic()
        if now >= self._next_beat:
            self._beat(now)
        if self._early:
            return self._early.popleft()
        arrival = self.bus.receive(min(timeout_s, max(self._next_beat - now, 0.0)))
        if self._stop.requested:
            self._ask_to_stop()
        if arrival is None or not arrival.key:
            return None
        if not arrival.key.startswith((ALIVE, READY, BEAT, CONTROL)):
            return arrival
        try:
            self._take(arrival, now)
        except ProtocolError as error:
            say(self.name, f"{arrival.key}: message refused: {error}")
        return None

    def assemble(self, *, leads: bool) -> None:
        """Wait until every peer is alive, and say so by being ready; who ``leads`` the run waits for that of all.

        The others must not wait any longer: as soon as all are ready the first messages may come.
        """
        self.bus.declare(f"{ALIVE}{self.name}/{self.boot}")
        self._wait(lambda: self.peers - self.boots.keys(), "waiting for")
        self.bus.declare(f"{READY}{self.name}/{self.boot}")
        if leads:
            self._wait(lambda: self.peers - self._ready, "waiting until ready:")

    def behind(self, peer: str) -> int:
        """Return how many ticks ``peer`` had behind it at its last beat."""
        return self._peer_ticks.get(peer, 0)

    def await_recorded(self, timeout_s: float = 30.0) -> Recorded:
        """Wait for the recorder's word that it has the whole run; raises RunError if it does not come."""
        self.leaving = True
        deadline = time.monotonic() + timeout_s
        while self.recorded is None:
            if time.monotonic() > deadline:
                raise RunError(f"the recorder has not confirmed the run within {timeout_s:g} s")
            self.poll()
        return self.recorded

    def _wait(self, missing: Callable[[], set[str]], what: str) -> None:
        told: set[str] = set()
        early: list[Arrival] = []  # from strangers: to be refused as any other
        tell_at = time.monotonic() + 1.0
        while names := missing():
            if time.monotonic() > tell_at and names != told:
                told = names
                say(self.name, f"{what} {', '.join(sorted(names))}")
            arrival = self.poll(0.1)
            if arrival is not None:
                early.append(arrival)
            if self._stop.requested:
                raise KeyboardInterrupt
        self._early.extend(early)

    def _beat(self, now: float) -> None:
        self._next_beat = now + BEAT_S
        self.bus.put(f"{BEAT}{self.name}", encode_control(Beat(self.name, self.boot, self.ticks)))
        if not self.bus.connected and not self.leaving:
            raise BrokenOffError("the router is gone; the run cannot go on")
        if not self.leaving:
            for peer, seen in self._beats.items():
                if peer in self.peers and now - seen > WEDGED_S:
                    raise BrokenOffError(f"{peer} has not answered for {WEDGED_S:g} s: it hangs; the run cannot go on")

    def _take(self, arrival: Arrival, now: float) -> None:
        if arrival.key.startswith((ALIVE, READY)):
            self._token(arrival)
        elif arrival.key.startswith(BEAT):
            beat = decode_control(arrival.payload, Beat)
            if self.boots.get(beat.node) == beat.boot:  # a stranger's says nothing of the peer whose name it takes
                self._beats[beat.node] = now
                self._peer_ticks[beat.node] = beat.ticks
        else:
            self._control(arrival)

    def _token(self, arrival: Arrival) -> None:
        prefix = ALIVE if arrival.key.startswith(ALIVE) else READY
        node, _, boot = arrival.key[len(prefix) :].rpartition("/")
        if node not in self.peers:
            return
        if arrival.present:
            if prefix == READY:
                self._ready.add(node)
            elif self.boots.setdefault(node, boot) != boot:
                say(self.name, f"a second {node} (boot {boot}) is refused; this run's is {self.boots[node]}")
            return
        if prefix == READY or self.boots.get(node) != boot or self.leaving:
            return
        if node not in self._ready:
            del self.boots[node]  # it left before the run began; another may come
            return
        if node == RECORDER and self.recorded is not None:
            return
        time.sleep(SURE_S)
        if not self.bus.connected:
            raise BrokenOffError("the router is gone; the run cannot go on")
        raise BrokenOffError(
            f"{node} is gone (killed, crashed or cut off) after tick {self.ticks}; the run cannot go on"
        )

    def _control(self, arrival: Arrival) -> None:
        what = arrival.key[len(CONTROL) :]
        if what == "recorded":
            self.recorded = decode_control(arrival.payload, Recorded)
            if not self.recorded.complete and not self.leaving:
                raise BrokenOffError(f"the recorder has closed the recording: {self.recorded.reason}")
        elif what == "stop":
            self.stop_reason = decode_control(arrival.payload, Stop).reason

    def _ask_to_stop(self) -> None:
        if self._stop.at_once:
            raise KeyboardInterrupt
        if not self._stop_sent:
            self._stop_sent = True
            self.stop_reason = self.stop_reason or self._stop.reason
            self.bus.put(f"{CONTROL}stop", encode_control(Stop(self.name, self._stop.reason)))


class StopSignal:
    """Ctrl-C or a termination signal: the first asks the run to end cleanly, the second ends this process at once.

    So does the end of ``parent``, the process that started this one and would otherwise have stopped it.
    """

    def __init__(self, parent: int | None = None) -> None:
        self._parent = parent
        self._requested = False
        self.at_once = False
        self.reason = ""
        self._wake: Callable[[], None] | None = None

    @property
    def requested(self) -> bool:
        if self._parent is not None and not self._requested and os.getppid() != self._parent:
            self.request("the process that started this one is gone")
        return self._requested

    def request(self, reason: str) -> None:
        self.at_once = self._requested
        self._requested = True
        self.reason = self.reason or reason
        if self._wake is not None:
            self._wake()

    def wakes(self, bus: Bus) -> None:
        self._wake = bus.wake

    @classmethod
    @contextmanager
    def installed(cls, parent: int | None = None) -> Iterator["StopSignal"]:
        """Catch SIGINT and SIGTERM while the block runs."""
        stop = cls(parent)

        def handle(_number: int, _frame: FrameType | None) -> None:
            stop.request("stopped by the user")

        before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield stop
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


@contextmanager
def join(name: str, plan: Plan, endpoint: str, stop: StopSignal) -> Iterator[Member]:
    """Connect to the router and become a member, refusing to when the scenario or the name does not fit.

    Subscribe what is needed on the member's bus, then ``assemble``.
    """
    with Bus.connect(endpoint, lambda text: say(name, text), lambda: stop.requested) as bus:
        stop.wakes(bus)
        _same_scenario(name, bus, plan.text, endpoint, stop)
        if taken := bus.tokens(f"{ALIVE}{name}/*"):
            raise UsageError(f"{name} already runs at {endpoint} (boot {taken[0].rpartition('/')[2]}); stop it first")
        member = Member(name, bus, plan, new_boot(), stop)
        bus.subscribe(f"{CONTROL}*")
        bus.subscribe(f"{BEAT}**")
        bus.watch(f"{ALIVE}**")
        bus.watch(f"{READY}**")
        yield member


def _same_scenario(name: str, bus: Bus, ours: str, endpoint: str, stop: StopSignal) -> None:
    theirs = bus.ask(SCENARIO, patience_s=5.0, stopped=lambda: stop.requested)
    if stop.requested:
        raise KeyboardInterrupt
    if theirs is None:
        raise RunError(f"the router at {endpoint} does not say which scenario it runs; is it a dynpf router?")
    try:
        difference = first_difference(ours, theirs.decode())
    except (ValueError, RecursionError) as error:  # the text is compared, and nothing that it names is looked for
        raise RunError(f"the router at {endpoint} tells a scenario that cannot be read: {error}") from error
    if difference is not None:
        key, here, there = difference
        raise UsageError(
            f"{name}: refused: this scenario differs from the router's in {key}: here {here!r}, there {there!r}"
        )
