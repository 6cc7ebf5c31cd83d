"""A simulated process: its machine, its connection to the router, and what has become of it."""

from collections import deque
from collections.abc import Callable
from random import Random
from typing import NamedTuple

from dynpf_protocol.errors import DynpfError

from dynpf_runtime.machines.effects import NEVER_NS, Effect, Machine
from dynpf_runtime.machines.events import Event, Started
from dynpf_runtime.simulation.keys import first_match

__all__ = ["KILLED", "RETRY_NS", "Closing", "Killed", "Link", "Network", "Perform", "Process"]

RETRY_NS = 50_000_000
"""How often a new process looks for the router."""

_NOTICE_NS = 1_000_000_000  # after that it says so

KILLED = -9
"""Exit code of a process that was killed."""

Perform = Callable[[Effect], Event | None]
"""Carries out an effect that does not concern the bus, and returns the event that follows, if any."""

Closing = Callable[[BaseException | None], None]
"""What a process does on its way out, with its error if it has one."""


class Killed(BaseException):
    """The process is killed in the midst of an effect, such as a write to its disk."""


class Network(NamedTuple):
    """Longest durations; each is drawn uniformly between zero and this many nanoseconds."""

    delay_ns: int = 2_000_000  # from a process to the router, or back
    work_ns: int = 200_000  # to handle an event
    start_ns: int = 100_000_000  # until a process has started
    answer_ns: int = 0  # until the answer to a query has come, beyond the delay


class Link:
    """One direction of a process's connection to the router, which keeps the order of messages."""

    def __init__(self, random: Random, delay_ns: int) -> None:
        self._random = random
        self._delay_ns = delay_ns
        self._last_ns = 0

    def arrival_ns(self, now_ns: int, extra_ns: int = 0) -> int:
        """Return when a message arrives that is sent at ``now_ns`` and is ``extra_ns`` late; later ones wait for it."""
        arrival_ns = now_ns + 1 + extra_ns + int(self._random.random() * self._delay_ns)
        self._last_ns = max(self._last_ns, arrival_ns)
        return self._last_ns

    def stall(self, until_ns: int) -> None:
        """Let nothing arrive before a time."""
        self._last_ns = max(self._last_ns, until_ns)


class Process:
    """A machine, and the state of its simulated process.

    ``closing`` is called with its error when the process ends by itself: what a real process does on its way out.
    """

    def __init__(
        self,
        name: str,
        machine: Machine,
        perform: Perform,
        links: list[Link],
        closing: Closing | None = None,
    ) -> None:
        self.name = name
        self.machine = machine
        self.perform = perform
        self.closing = closing
        self.to_router, self.from_router = links
        self.threads: dict[str, Link] = {}  # by subscribed or watched key
        self.inbox: deque[Event] = deque([Started()])
        self.subscribed: list[str] = []
        self.hears: dict[str, bool] = {}  # key -> whether it is among those subscribed
        self.registered: list[str] = []  # its subscriptions that the router knows
        self.watches: list[str] = []
        self.watched: list[str] = []  # what it watches, as far as the router knows
        self.declared: list[str] = []
        self.offered: list[tuple[str, bytes]] = []  # answers to queries
        self.seen: dict[str, None] = {}  # tokens of which it has been told that they are there, in that order
        self.busy_ns = 0
        self.planned_ns = NEVER_NS
        self.running = True  # it was not killed, and its machine has not ended
        self.exit_code: int | None = None
        self.hangs = False
        self.stopped = False  # by a signal such as SIGSTOP
        self.resumes_ns = NEVER_NS  # when it goes on, if it hangs
        self.connection = 0  # its number; 0 if it has none
        self.linked = True  # whether it takes itself to be connected
        self.partings = 0  # how often its connection was given up while it was cut off
        self.cut_ns = 0  # until when its connection is down
        self.events = 0  # handled so far
        self.began_ns = NEVER_NS
        self.began_events = 0  # handled by earlier starts of it
        self.turned_ns = 0  # when the last one was
        self.doomed: tuple[int, int] | None = None  # effects until it is killed, and how many sendings that loses
        self.unsent: deque[list[Callable[[], None]]] = deque(maxlen=16)  # the last sendings, emptied if they are lost
        self.idle_wakes = self.most_idle_wakes = 0  # in a row: it wakes, does nothing, and is due at once again
        self.arrivals = 0  # messages that the router has sent to it
        self.slow: tuple[int, int] = (0, 0)  # events, and how much longer each takes, ns

    def tells_of_router(self, now_ns: int) -> bool:
        """Return whether a new process that looks for the router every RETRY_NS now says that it waits for it."""
        return 0 <= now_ns - self.began_ns - _NOTICE_NS < RETRY_NS

    def hears_itself(self, key: str) -> bool:
        """Return whether the process subscribes to a key under which it publishes."""
        hears = self.hears.get(key)
        if hears is None:
            hears = self.hears[key] = first_match(self.subscribed, key) is not None
        return hears

    @property
    def alive(self) -> bool:
        """Whether it does something, or will."""
        return self.running and (not self.hangs or self.resumes_ns < NEVER_NS)

    def end(self, error: BaseException | None) -> None:
        """Note that the process ends by itself."""
        self.exit_code = error.exit_code if isinstance(error, DynpfError) else int(error is not None)
        self.running = False
