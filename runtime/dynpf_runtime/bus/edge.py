"""The edge: connects the machine of one process to the bus, the clock, the signals and the terminal."""

import time
import uuid
from collections import deque
from collections.abc import Callable

from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.effects import (
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

__all__ = ["Perform", "drive", "new_boot"]

Perform = Callable[[Effect], Event | None]
"""Carries out an effect that does not concern the bus, and returns the event that follows, if any."""


def new_boot() -> str:
    """Return a name for this start of a process."""
    return uuid.uuid4().hex[:12]


def refuse(effect: Effect) -> None:
    """Raise TypeError: for machines all of whose effects concern the bus."""
    raise TypeError(f"no one carries out {effect!r} here")


def drive(name: str, machine: Machine, bus: Bus, stop: StopSignal, perform: Perform = refuse) -> None:
    """Run ``machine`` on ``bus`` until it ends; raises the error it ends with, and whatever ``perform`` raises."""
    edge = _Edge(name, machine, bus, perform)
    stop.wakes(bus.wake)
    edge.handle(Started())
    stop_requests = 0
    while edge.ended is None:
        event: Event | None = bus.receive((machine.wake_ns - time.monotonic_ns()) * 1e-9)
        if stop.requested and stop_requests < 1 + stop.at_once:
            stop_requests = 1 + stop.at_once
            edge.handle(StopAsked(stop.reason, stop.at_once))
        if event is not None:
            edge.handle(event)
        elif not bus.waiting and time.monotonic_ns() >= machine.wake_ns:
            if not bus.connected:
                edge.handle(RouterGone())
            edge.handle(Woke())
    if edge.ended.error is not None:
        raise edge.ended.error


class _Edge:
    """Passes events to the machine, and carries out its effects."""

    def __init__(self, name: str, machine: Machine, bus: Bus, perform: Perform) -> None:
        self.ended: Ended | None = None
        self._name = name
        self._machine = machine
        self._bus = bus
        self._perform = perform
        self._answers: deque[Event] = deque()

    def handle(self, event: Event) -> None:
        """Let the machine handle ``event`` and the events that follow from its effects; do nothing after the end."""
        self._answers.append(event)
        while self._answers and self.ended is None:
            for effect in self._machine.handle(self._answers.popleft(), Now(time.monotonic_ns(), time.time_ns())):
                if type(effect) is Put:
                    self._bus.put(*effect)
                else:
                    self._do(effect)

    def _do(self, effect: Effect) -> None:
        bus = self._bus
        match effect:
            case Subscribe(key):
                bus.subscribe(key)
            case Watch(key):
                bus.watch(key)
            case Declare(key):
                bus.declare(key)
            case Answer(key, payload):
                bus.answer(key, payload)
            case Ask(key, wanted):
                self._answers.append(Answered(bus.ask(key, wanted)))
            case Count(key):
                self._answers.append(Counted(tuple(sorted(set(bus.tokens(key))))))
            case Tell(text):
                say(self._name, text)
            case Ended():
                self.ended = effect
            case _:
                if (event := self._perform(effect)) is not None:
                    self._answers.append(event)
