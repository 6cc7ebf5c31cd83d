"""Simulation: the machines of a whole run in one process, on a seeded network and a clock of their own.

The network is what Zenoh makes of processes around one router: whatever a process sends goes to the router and from
there to whoever wants it, in its order on each of these ways, late by chance on each. Liveliness tokens and questions
take the same ways. Two simulations of the same machines under the same seed do the same.
"""

import heapq
from collections import Counter, deque
from collections.abc import Callable
from functools import cache, partial
from random import Random
from typing import NamedTuple

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
    Arrived,
    Counted,
    Event,
    Now,
    RouterGone,
    Started,
    StopAsked,
    Token,
    Woke,
)

__all__ = ["Happened", "Network", "Simulation"]

_EPOCH_NS = 1_700_000_000 * 10**9
_CUT_NS = 20_000_000  # until a process knows that the router is gone, after it has seen the others' tokens go


class Happened(NamedTuple):
    """One effect of a process, or the event that it is told of, and when."""

    at_ns: int
    process: str
    what: Event | Effect


class Network(NamedTuple):
    """How long things take, each drawn evenly from zero to this many nanoseconds."""

    delay_ns: int = 2_000_000  # from a process to the router, or back
    work_ns: int = 200_000  # to handle an event
    start_ns: int = 100_000_000  # until a process has started


_NETWORK = Network()


class _Way:
    """One direction of a process's connection to the router: nothing overtakes."""

    def __init__(self, random: Random, delay_ns: int) -> None:
        self._random = random
        self._delay_ns = delay_ns
        self._last_ns = 0

    def arrival_ns(self, now_ns: int) -> int:
        self._last_ns = max(self._last_ns, now_ns + 1 + int(self._random.random() * self._delay_ns))
        return self._last_ns


class _Process:
    """A machine, and what is around it."""

    def __init__(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None], ways: list[_Way]):
        self.name = name
        self.machine = machine
        self.perform = perform
        self.to_router, self.from_router = ways
        self.inbox: deque[Event] = deque([Started()])
        self.subscribed: list[str] = []
        self.known: list[str] = []  # what of it the router knows
        self.watched: list[str] = []
        self.busy_ns = 0
        self.planned_ns = NEVER_NS
        self.running = True  # it is there, and its machine has not ended
        self.hangs = False
        self.linked = True  # as far as it knows itself


class Simulation:
    """Processes by names of the simulation's own, one of which, ``router``, the others go through.

    What has happened so far stands in ``story``, and who has ended, with what, in ``ended``. ``lost`` is asked of each
    message on its way from the router to a process whether it is lost there.
    """

    def __init__(self, seed: int, router: str, network: Network = _NETWORK) -> None:
        self.now_ns = 0
        self.story: list[Happened] = []
        self.ended: dict[str, BaseException | None] = {}
        self.published: Counter[str] = Counter()
        self.lost: Callable[[str, Arrived], bool] = lambda _process, _arrived: False
        self._random = Random(seed)
        self._router = router
        self._network = network
        self._processes: dict[str, _Process] = {}
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        self._open = True  # the router, to whoever is connected
        self._tokens: dict[str, _Process] = {}
        self._answers: dict[str, bytes] = {}
        self._routes: dict[str, list[_Process]] = {}

    def add(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None] | None = None) -> None:
        """Start a process a while from now; ``perform`` carries out what is not of the bus."""
        if name in self._processes:
            raise ValueError(f"there is a process {name!r} already; give the second one another name")
        delay_ns = 0 if name == self._router else self._network.delay_ns
        ways = [_Way(self._random, delay_ns) for _ in range(2)]
        process = self._processes[name] = _Process(name, machine, perform or _refuse, ways)
        process.busy_ns = self.now_ns + self._draw(self._network.start_ns)
        self._plan(process)

    def run(self, until: Callable[[], bool] | None = None, limit_ns: int = 600 * 10**9) -> None:
        """Go on until every process has ended or hangs, or ``until`` is true; raises TimeoutError at ``limit_ns``."""
        while self._agenda and not (until is not None and until()):
            if not any(process.running and not process.hangs for process in self._processes.values()):
                return
            at_ns, _, act = heapq.heappop(self._agenda)
            if at_ns > limit_ns:
                raise TimeoutError(f"the run has not ended after {limit_ns / 1e9:g} simulated seconds")
            self.now_ns = max(self.now_ns, at_ns)
            act()

    def kill(self, name: str) -> None:
        """End a process where it stands; what it has sent already arrives."""
        self._leave(self._processes[name])

    def hang(self, name: str) -> None:
        """Let a process do nothing any more, though it is there."""
        self._processes[name].hangs = True

    def ask_to_stop(self, name: str, reason: str, *, at_once: bool = False) -> None:
        """Do what a signal does to a process."""
        self._arrive(self._processes[name], StopAsked(reason, at_once))

    def publish(self, key: str, payload: bytes, attachment: bytes = b"") -> None:
        """Publish as somebody who is no process of the run."""
        self._route(Arrived(key, payload, attachment), but=None)

    def told(self, name: str) -> list[str]:
        """Return what a process has told the person at the terminal."""
        return [one.what.text for one in self.story if one.process == name and type(one.what) is Tell]

    def _plan(self, process: _Process) -> None:
        """Have a process served when it is free and there is something to do."""
        due_ns = process.busy_ns if process.inbox else max(process.busy_ns, process.machine.wake_ns)
        if not process.running or process.hangs or due_ns >= process.planned_ns:
            return
        process.planned_ns = due_ns
        self._at(due_ns, lambda: self._serve(process, due_ns))

    def _serve(self, process: _Process, planned_ns: int) -> None:
        if not process.running or process.hangs or planned_ns != process.planned_ns:
            return  # it was planned anew
        process.planned_ns = NEVER_NS
        if process.inbox:
            self._handle(process, process.inbox.popleft())
        elif self.now_ns >= process.machine.wake_ns:
            if not process.linked:
                self._handle(process, RouterGone())
            self._handle(process, Woke())
        process.busy_ns = self.now_ns + 1 + self._draw(self._network.work_ns)
        self._plan(process)

    def _handle(self, process: _Process, event: Event) -> None:
        if not process.running:
            return
        self.story.append(Happened(self.now_ns, process.name, event))
        try:
            for effect in process.machine.handle(event, Now(self.now_ns, _EPOCH_NS + self.now_ns)):
                self.story.append(Happened(self.now_ns, process.name, effect))
                self._do(process, effect)
                if not process.running:
                    return
        except Exception as error:  # it would be the end of a real process, too
            self._end(process, error)

    def _do(self, process: _Process, effect: Effect) -> None:
        match effect:
            case Put():
                self._put(process, Arrived(*effect))
            case Tell():
                pass  # it stands in the story
            case Ended(error):
                self._end(process, error)
            case Subscribe(key):
                process.subscribed.append(key)
                self._send(process, lambda: self._subscribe(process, key))
            case Watch(key):
                self._send(process, lambda: self._watch(process, key))
            case Declare(key):
                self._send(process, lambda: self._declare(process, key))
            case Answer(key, payload):
                self._answers[key] = payload
            case Ask(key):
                self._send(process, lambda: self._reply(process, Answered(self._answers.get(key))))
            case Count(key):
                self._send(process, lambda: self._reply(process, Counted(tuple(sorted(self._matching(key))))))
            case _:
                if (event := process.perform(effect)) is not None:
                    process.inbox.appendleft(event)

    def _end(self, process: _Process, error: BaseException | None) -> None:
        self.ended[process.name] = error
        self._leave(process)

    def _leave(self, process: _Process) -> None:
        process.running = False
        if process.name == self._router:
            self._close()
        else:
            self._send(process, lambda: self._forget(process))

    def _arrive(self, process: _Process, event: Event) -> None:
        if process.running:
            process.inbox.append(event)
            self._plan(process)

    def _at(self, at_ns: int, act: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._agenda, (at_ns, self._count, act))

    def _draw(self, most_ns: int) -> int:
        return int(self._random.random() * most_ns)

    def _send(self, process: _Process, act: Callable[[], None]) -> None:
        """Let something happen at the router when word of it has come there."""
        self._at(process.to_router.arrival_ns(self.now_ns), lambda: act() if self._open else None)

    def _reply(self, process: _Process, event: Event) -> None:
        """Let something arrive at a process when it has come from the router."""
        self._at(process.from_router.arrival_ns(self.now_ns), lambda: self._arrive(process, event))

    def _put(self, process: _Process, arrived: Arrived) -> None:
        self.published[arrived.key] += 1
        if any(matches(pattern, arrived.key) for pattern in process.subscribed):
            self._arrive(process, arrived)  # one's own comes back at once, as from Zenoh
        self._send(process, lambda: self._route(arrived, but=process))

    def _route(self, arrived: Arrived, but: _Process | None) -> None:
        receivers = self._routes.get(arrived.key)
        if receivers is None:
            every = self._processes.values()
            receivers = [one for one in every if any(matches(pattern, arrived.key) for pattern in one.known)]
            self._routes[arrived.key] = receivers
        for receiver in receivers:
            if receiver is not but and not self.lost(receiver.name, arrived):
                self._reply(receiver, arrived)

    def _subscribe(self, process: _Process, key: str) -> None:
        process.known.append(key)
        self._routes.clear()

    def _watch(self, process: _Process, key: str) -> None:
        process.watched.append(key)
        for token in self._matching(key):
            self._reply(process, Token(token, True))

    def _declare(self, process: _Process, key: str) -> None:
        self._tokens[key] = process
        self._tell_token(Token(key, True))

    def _tell_token(self, token: Token) -> None:
        for watcher in self._processes.values():
            if any(matches(pattern, token.key) for pattern in watcher.watched):
                self._reply(watcher, token)

    def _matching(self, key: str) -> list[str]:
        return [token for token in self._tokens if matches(key, token)]

    def _forget(self, process: _Process) -> None:
        """Take away what a process has had at the router."""
        process.known.clear()
        process.watched.clear()
        self._routes.clear()
        for token in [token for token, holder in self._tokens.items() if holder is process]:
            del self._tokens[token]
            self._tell_token(Token(token, False))

    def _close(self) -> None:
        """End the router: whoever is connected sees the others' tokens go, and a moment later that it is cut off."""
        for token in self._tokens:
            self._tell_token(Token(token, False))
        for process in self._processes.values():
            self._at(process.from_router.arrival_ns(self.now_ns) + self._draw(_CUT_NS), partial(_cut, process))
        self._open = False
        self._tokens.clear()


def _cut(process: _Process) -> None:
    process.linked = False


@cache
def matches(pattern: str, key: str) -> bool:
    """Return whether ``key`` is among the keys that ``pattern`` stands for."""
    return _match(pattern.split("/"), key.split("/"))


def _match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_match(pattern[1:], key[skipped:]) for skipped in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _match(pattern[1:], key[1:])


def _refuse(effect: Effect) -> Event | None:
    raise TypeError(f"nobody here carries out {effect!r}")
