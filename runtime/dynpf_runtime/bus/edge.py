"""The edge: connects the machine of one process to the bus, the clock, the signals and the terminal."""

import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import msgspec
import zenoh
from dynpf_protocol.control import Beat, Doing, decode_control, encode_control
from dynpf_protocol.keys import BEAT

from dynpf_runtime.bus.pulse import Pulse, Reading
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.effects import (
    NEVER_NS,
    Answer,
    Ask,
    Count,
    Declare,
    Effect,
    Ended,
    Machine,
    Put,
    Subscribe,
    Tell,
    Watch,
)
from dynpf_runtime.machines.events import (
    Answered,
    Counted,
    Event,
    Now,
    RouterGone,
    Started,
    StopAsked,
    Woke,
)

__all__ = ["Perform", "drive", "late_beat", "new_boot"]

Perform = Callable[[Effect], Event | None]
"""Carries out an effect that does not concern the bus, and returns the event that follows, if any."""

_LATE_NS = 750_000_000
"""After this, a main loop that goes round twice a second is late with its heartbeat."""

_STAND_IN_S = 0.25

_ASK_AGAIN_NS = 100_000_000

_OF_THE_BUS = (Subscribe, Watch, Declare, Answer)


def new_boot() -> str:
    """Return a name for this start of a process."""
    return uuid.uuid4().hex[:12]


def refuse(effect: Effect) -> None:
    """Raise TypeError: for machines all of whose effects concern the bus."""
    raise TypeError(f"no one carries out {effect!r} here")


def late_beat(beat: Put, pulse: Reading, now_ns: int) -> Put | None:
    """Return a process's last heartbeat with what its main loop does instead of the next one; None if it is in time.

    None, too, while the loop waits for the bus: another message would only wait behind it.
    """
    for_ns = now_ns - pulse.since_ns
    if for_ns <= _LATE_NS or pulse.doing is Doing.BUS:
        return None
    said = msgspec.structs.replace(decode_control(beat.payload, Beat), doing=pulse.doing, for_ns=for_ns)
    return beat._replace(payload=encode_control(said))


def drive(name: str, machine: Machine, bus: Bus, stop: StopSignal, perform: Perform = refuse, *, pulse: Pulse) -> None:
    """Run ``machine`` on ``bus`` until it ends; raises the error it ends with, and whatever ``perform`` raises.

    ``pulse`` tells at any time what this loop does; while it is long in one thing, its heartbeats say so.
    """
    edge = _Edge(name, machine, bus, pulse, perform)
    stop.wakes(bus.wake)
    with _understudy(edge):
        edge.handle(Started())
        stop_requests = 0
        while edge.ended is None:
            wake_ns = min(machine.wake_ns, edge.wake_ns)
            event: Event | None = bus.receive((wake_ns - time.monotonic_ns()) * 1e-9)
            if stop.requested and stop_requests < 1 + stop.at_once:
                stop_requests = 1 + stop.at_once
                edge.handle(StopAsked(stop.reason, stop.at_once))
            if event is not None:
                edge.handle(event)
            elif not bus.waiting and time.monotonic_ns() >= wake_ns:
                if edge.cut or not bus.connected:
                    edge.cut = False
                    edge.handle(RouterGone())
                edge.ask_again()
                edge.handle(Woke())
    pulse.now(Doing.ENDED)
    if edge.ended.error is not None:
        raise edge.ended.error


@contextmanager
def _understudy(edge: "_Edge") -> Iterator[None]:
    """Publish heartbeats in a thread while the main loop is too long in one thing to publish its own."""
    over = threading.Event()

    def stand_in() -> None:
        while not over.wait(_STAND_IN_S):
            edge.beat_if_late()

    thread = threading.Thread(target=stand_in, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(_STAND_IN_S)  # it may be held up by the bus


class _Edge:
    """Passes events to the machine, and carries out its effects."""

    def __init__(self, name: str, machine: Machine, bus: Bus, pulse: Pulse, perform: Perform) -> None:
        self.ended: Ended | None = None
        self.cut = False  # whether the bus has refused a message, because the router is gone
        self.wake_ns = NEVER_NS  # when to ask again what the bus has refused to ask
        self._name = name
        self._machine = machine
        self._bus = bus
        self._pulse = pulse
        self._perform = perform
        self._answers: deque[Event] = deque()
        self._unasked: list[Ask | Count] = []
        self._beat: Put | None = None  # the machine's last heartbeat

    def handle(self, event: Event) -> None:
        """Let the machine handle ``event`` and the events that follow from its effects; do nothing after the end."""
        self._answers.append(event)
        pulse = self._pulse
        while self._answers and self.ended is None:
            now_ns = time.monotonic_ns()
            pulse.turn(now_ns)
            for effect in self._machine.handle(self._answers.popleft(), Now(now_ns, time.time_ns())):
                if type(effect) is Put:
                    pulse.now(Doing.BUS)
                    self._put(effect)
                elif isinstance(effect, Ask | Count):
                    pulse.now(Doing.BUS)
                    self._question(effect)
                elif type(effect) in _OF_THE_BUS:
                    pulse.now(Doing.BUS)
                    self._declare(effect)
                else:
                    pulse.now(Doing.FILE)
                    self._do(effect)
                pulse.now(Doing.TURNING)

    def ask_again(self) -> None:
        """Ask what the bus has refused to ask: the machine waits for the answer, and does nothing without it."""
        unasked, self._unasked, self.wake_ns = self._unasked, [], NEVER_NS
        for question in unasked:
            self._question(question)

    def beat_if_late(self) -> None:
        """Publish the last heartbeat again, with what the main loop does instead of publishing the next one."""
        late = None if self._beat is None else late_beat(self._beat, self._pulse.read(), time.monotonic_ns())
        if late is not None:
            with suppress(zenoh.ZError):
                self._bus.put(*late)

    def _put(self, put: Put) -> None:
        if put.key.startswith(BEAT):
            self._beat = put
        with self._noticed():
            self._bus.put(*put)

    @contextmanager
    def _noticed(self) -> Iterator[None]:
        """Note that the router is gone if the bus refuses something."""
        try:
            yield
        except zenoh.ZError:
            self.cut = True

    def _declare(self, effect: Effect) -> None:
        """Carry out an effect that concerns the bus."""
        bus = self._bus
        with self._noticed():
            match effect:
                case Subscribe(key):
                    bus.subscribe(key)
                case Watch(key):
                    bus.watch(key)
                case Declare(key):
                    bus.declare(key)
                case Answer(key, payload):
                    bus.answer(key, payload)

    def _question(self, question: Ask | Count) -> None:
        """Ask the bus; a question that it refuses, as without a router, stays: the machine waits for the answer."""
        bus = self._bus
        try:
            if isinstance(question, Ask):
                self._answers.append(Answered(bus.ask(*question)))
            else:
                self._answers.append(Counted(question.key, tuple(sorted(set(bus.tokens(question.key))))))
        except zenoh.ZError:
            self.cut = True
            self._unasked.append(question)
            self.wake_ns = time.monotonic_ns() + _ASK_AGAIN_NS

    def _do(self, effect: Effect) -> None:
        match effect:
            case Tell(text):
                say(self._name, text)
            case Ended():
                self.ended = effect
            case _:
                if (event := self._perform(effect)) is not None:
                    self._answers.append(event)
