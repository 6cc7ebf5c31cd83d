"""A simulated process: a machine, its connection to the router, and what it has subscribed to and declared there."""

from collections import deque
from collections.abc import Callable
from random import Random

from dynpf_runtime.machines.effects import NEVER_NS, Effect, Machine
from dynpf_runtime.machines.events import Event, Started

__all__ = ["Link", "Process"]


class Link:
    """One direction of a process's connection to the router, which keeps the order of messages."""

    def __init__(self, random: Random, delay_ns: int) -> None:
        self._random = random
        self._delay_ns = delay_ns
        self._last_ns = 0

    def arrival_ns(self, now_ns: int) -> int:
        """Return the time of arrival of a message sent at ``now_ns``."""
        self._last_ns = max(self._last_ns, now_ns + 1 + int(self._random.random() * self._delay_ns))
        return self._last_ns


class Process:
    """A machine, and the state of its simulated process."""

    def __init__(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None], links: list[Link]):
        self.name = name
        self.machine = machine
        self.perform = perform
        self.to_router, self.from_router = links
        self.threads: dict[str, Link] = {}  # by subscribed or watched key
        self.inbox: deque[Event] = deque([Started()])
        self.subscribed: list[str] = []
        self.registered: list[str] = []  # its subscriptions that the router knows
        self.watched: list[str] = []
        self.watches: list[str] = []
        self.declared: list[str] = []
        self.router = 0  # the start of the router to which it is connected
        self.busy_ns = 0
        self.planned_ns = NEVER_NS
        self.running = True  # it was not killed, and its machine has not ended
        self.hangs = False
        self.linked = True  # whether it takes itself to be connected
