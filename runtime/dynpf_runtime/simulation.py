"""Simulation: the machines of a whole run in one process, on a seeded network and a simulated clock.

The network behaves like Zenoh with processes around one router: every message goes to the router and from there to the
subscribers, each connection keeps the order and delays messages at random. Liveliness tokens and queries take the same
connections. In a process each subscription has a thread of its own, so that only what comes by one subscription keeps
its order. Two simulations of the same machines under the same seed give the same story.
"""

import heapq
from collections import Counter, defaultdict
from collections.abc import Callable
from functools import partial
from random import Random
from typing import NamedTuple

from dynpf_runtime.key_expressions import first_match, matches
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
from dynpf_runtime.simulated_process import Link, Process

__all__ = ["Happened", "Network", "Simulation"]

_EPOCH_NS = 1_700_000_000 * 10**9
_LEASE_NS = 1_500_000_000
_THREAD_NS = 200_000  # longest time from a message's arrival until the thread of its subscription has passed it on
_RECONNECT_NS = 200_000_000  # longest time until a process has found a router that was started again
_RETRY_NS = 50_000_000  # how often a new process looks for the router
_UNANSWERED_NS = 1_000_000_000  # how long a process waits for an answer
_CUT_NS = 20_000_000  # longest time from the loss of the others' tokens until a process knows that the router is gone


class Happened(NamedTuple):
    """One event or effect of a process, and its time."""

    at_ns: int
    process: str
    what: Event | Effect


class Network(NamedTuple):
    """Longest durations; each is drawn uniformly between zero and this many nanoseconds."""

    delay_ns: int = 2_000_000  # from a process to the router, or back
    work_ns: int = 200_000  # to handle an event
    start_ns: int = 100_000_000  # until a process has started


_NETWORK = Network()


class Simulation:
    """Processes by name, connected through the one named ``router``.

    ``story`` lists what has happened so far, ``ended`` the processes that have ended, each with its error. ``lost``
    decides for each message from the router to a process whether it is lost. ``watch`` sees all that happens, and may
    kill a process before it has done an effect.
    """

    def __init__(self, seed: int, router: str, network: Network = _NETWORK) -> None:
        self.now_ns = 0
        self.story: list[Happened] = []
        self.ended: dict[str, BaseException | None] = {}
        self.published: Counter[str] = Counter()
        self.lost: Callable[[str, Arrived], bool] = lambda _process, _arrived: False
        self.watch: Callable[[Happened], None] = lambda _happened: None
        self._random = Random(seed)
        self._router = router
        self._network = network
        self._processes: dict[str, Process] = {}
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        self._open = True  # whether the router runs
        self._routers = 0  # how often the router has been started again
        self._tokens: dict[str, Process] = {}
        self._answers: defaultdict[str, list[bytes]] = defaultdict(list)
        self._routes: dict[str, list[tuple[Process, str]]] = {}  # key -> who subscribes to it, and by which pattern

    def add(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None] | None = None) -> None:
        """Start a process after a random delay; ``perform`` carries out effects that do not concern the bus."""
        if name in self._processes:
            raise ValueError(f"there is a process {name!r} already; give the second one another name")
        self._start(name, machine, perform)

    def restart(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None] | None = None) -> None:
        """Start a process again, after ending the one that has its name; clients connect to a new router again."""
        before = self._processes[name]
        if before.running:
            self.kill(name)
        self.ended.pop(name, None)
        if name == self._router:
            self._routers += 1
            self._open = True
            self._answers.clear()
            for process in self._processes.values():
                if process.running and process is not before:
                    self._at(self.now_ns + self._draw(_RECONNECT_NS), partial(self._reconnect, process, self._routers))
        self._start(name, machine, perform)

    def _reconnect(self, process: Process, router: int) -> None:
        """Connect a process to the router again, which learns anew of its subscriptions and tokens."""
        if not process.running or process.hangs or router != self._routers:
            return
        process.linked, process.router = True, router
        for key in process.subscribed:
            self._send(process, partial(self._subscribe, process, key))
        for key in process.watches:
            self._send(process, partial(self._watch, process, key))
        for key in process.declared:
            self._send(process, partial(self._declare, process, key))

    def _start(self, name: str, machine: Machine, perform: Callable[[Effect], Event | None] | None) -> None:
        delay_ns = 0 if name == self._router else self._network.delay_ns
        links = [Link(self._random, delay_ns) for _ in range(2)]
        process = self._processes[name] = Process(name, machine, perform or _refuse, links)
        process.router = self._routers
        process.busy_ns = self.now_ns + self._draw(self._network.start_ns)
        self._plan(process)

    def later(self, delay_ns: int, act: Callable[[], None]) -> None:
        """Do something after a delay."""
        self._at(self.now_ns + delay_ns, act)

    def run(self, until: Callable[[], bool] | None = None, limit_ns: int = 600 * 10**9) -> None:
        """Run until every process has ended or hangs, or ``until`` is true; raises TimeoutError at ``limit_ns``."""
        while self._agenda and not (until is not None and until()):
            if not any(process.running and not process.hangs for process in self._processes.values()):
                return
            at_ns, _, act = heapq.heappop(self._agenda)
            if at_ns > limit_ns:
                raise TimeoutError(f"the run has not ended after {limit_ns / 1e9:g} simulated seconds")
            self.now_ns = max(self.now_ns, at_ns)
            act()

    def kill(self, name: str) -> None:
        """End a process at once; messages that it has already sent still arrive."""
        self._leave(self._processes[name])

    def hang(self, name: str) -> None:
        """Make a process stop handling events while it stays connected."""
        self._processes[name].hangs = True

    def freeze(self, name: str) -> None:
        """Stop a process as SIGSTOP does: it does nothing any more, and its connection is dropped after the lease."""
        process = self._processes[name]
        process.hangs = True
        if name == self._router:
            self._open = False
            self._at(self.now_ns + _LEASE_NS, partial(self._close_if, self._routers))
        else:
            self._at(self.now_ns + _LEASE_NS, lambda: self._forget(process))

    def ask_to_stop(self, name: str, reason: str, *, at_once: bool = False) -> None:
        """Act like a signal to a process."""
        self._arrive(self._processes[name], StopAsked(reason, at_once))

    def publish(self, key: str, payload: bytes, attachment: bytes = b"") -> None:
        """Publish as a stranger, not as a process of the run."""
        self._route(Arrived(key, payload, attachment), but=None)

    def notices(self, name: str) -> list[str]:
        """Return the texts that a process has printed for the user."""
        effects = (happened.what for happened in self.story if happened.process == name)
        return [effect.text for effect in effects if type(effect) is Tell]

    def _plan(self, process: Process) -> None:
        """Schedule a process for when it is free and has something to do."""
        due_ns = process.busy_ns if process.inbox else max(process.busy_ns, process.machine.wake_ns)
        if not process.running or process.hangs or due_ns >= process.planned_ns:
            return
        process.planned_ns = due_ns
        self._at(due_ns, lambda: self._serve(process, due_ns))

    def _serve(self, process: Process, planned_ns: int) -> None:
        if not process.running or process.hangs or planned_ns != process.planned_ns:
            return  # it has been rescheduled
        if not self._open and process.inbox and type(process.inbox[0]) is Started and process.name != self._router:
            process.planned_ns, process.busy_ns = NEVER_NS, self.now_ns + _RETRY_NS
            self._plan(process)  # it waits for the router
            return
        if process.inbox and type(process.inbox[0]) is Started:
            process.router = self._routers
        process.planned_ns = NEVER_NS
        if process.inbox:
            self._handle(process, process.inbox.popleft())
        elif self.now_ns >= process.machine.wake_ns:
            if not process.linked:
                self._handle(process, RouterGone())
            self._handle(process, Woke())
        process.busy_ns = self.now_ns + 1 + self._draw(self._network.work_ns)
        self._plan(process)

    def _handle(self, process: Process, event: Event) -> None:
        if not process.running:
            return
        self._note(process, event)
        try:
            for effect in process.machine.handle(event, Now(self.now_ns, _EPOCH_NS + self.now_ns)):
                self._note(process, effect)
                if process.running:
                    self._do(process, effect)
                if not process.running:
                    return
        except Exception as error:  # it would end a real process, too
            self._end(process, error)

    def _note(self, process: Process, what: Event | Effect) -> None:
        happened = Happened(self.now_ns, process.name, what)
        self.story.append(happened)
        self.watch(happened)

    def _do(self, process: Process, effect: Effect) -> None:
        match effect:
            case Put():
                self._put(process, Arrived(*effect))
            case Tell():
                pass  # the story has it
            case Ended(error):
                self._end(process, error)
            case Subscribe(key):
                process.subscribed.append(key)
                self._send(process, lambda: self._subscribe(process, key))
            case Watch(key):
                process.watches.append(key)
                self._send(process, lambda: self._watch(process, key))
            case Declare(key):
                process.declared.append(key)
                self._send(process, lambda: self._declare(process, key))
            case Answer(key, payload):
                self._answers[key].append(payload)
            case Ask(key, wanted):
                self._send(process, lambda: self._reply(process, Answered(self._answer(key, wanted))), Answered(None))
            case Count(key):
                self._send(
                    process, lambda: self._reply(process, Counted(tuple(sorted(self._matching(key))))), Counted(())
                )
            case _:
                if (event := process.perform(effect)) is not None:
                    process.inbox.appendleft(event)

    def _end(self, process: Process, error: BaseException | None) -> None:
        self.ended[process.name] = error
        self._leave(process)

    def _leave(self, process: Process) -> None:
        process.running = False
        if process.name == self._router:
            self._close()
        else:
            self._send(process, lambda: self._forget(process))

    def _arrive(self, process: Process, event: Event) -> None:
        if process.running:
            process.inbox.append(event)
            self._plan(process)

    def _at(self, at_ns: int, act: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._agenda, (at_ns, self._count, act))

    def _draw(self, most_ns: int) -> int:
        return int(self._random.random() * most_ns)

    def _send(self, process: Process, act: Callable[[], None], otherwise: Event | None = None) -> None:
        """Schedule an action of the router for when the process's message arrives there.

        If it is lost, because the router is gone, the process waits for an answer until that is ``otherwise``.
        """
        router = process.router

        def arrive() -> None:
            if self._open and router == self._routers:
                act()
            elif otherwise is not None:
                self._at(self.now_ns + _UNANSWERED_NS, lambda: self._arrive(process, otherwise))

        self._at(process.to_router.arrival_ns(self.now_ns), arrive)

    def _reply(self, process: Process, event: Event, pattern: str = "") -> None:
        """Send an event from the router to a process, where the thread of the subscription ``pattern`` takes it."""
        if pattern not in process.threads:
            process.threads[pattern] = Link(self._random, _THREAD_NS)
        at_ns = process.threads[pattern].arrival_ns(process.from_router.arrival_ns(self.now_ns))
        self._at(at_ns, lambda: self._arrive(process, event))

    def _put(self, process: Process, arrived: Arrived) -> None:
        self.published[arrived.key] += 1
        if any(matches(pattern, arrived.key) for pattern in process.subscribed):
            self._arrive(process, arrived)  # as in Zenoh, a process's own messages come back at once
        self._send(process, lambda: self._route(arrived, but=process))

    def _route(self, arrived: Arrived, but: Process | None) -> None:
        receivers = self._routes.get(arrived.key)
        if receivers is None:
            receivers = [
                (process, pattern)
                for process in self._processes.values()
                if (pattern := first_match(process.registered, arrived.key)) is not None
            ]
            self._routes[arrived.key] = receivers
        for receiver, pattern in receivers:
            if receiver is not but and not self.lost(receiver.name, arrived):
                self._reply(receiver, arrived, pattern)

    def _answer(self, key: str, wanted: bytes) -> bytes | None:
        """Return the wanted answer if anybody gives it, else one by chance."""
        answers = self._answers[key]
        if wanted in answers or not answers:
            return wanted if answers else None
        return self._random.choice(answers)

    def _subscribe(self, process: Process, key: str) -> None:
        process.registered.append(key)
        self._routes.clear()

    def _watch(self, process: Process, key: str) -> None:
        process.watched.append(key)
        for token in self._matching(key):
            self._reply(process, Token(token, True), key)

    def _declare(self, process: Process, key: str) -> None:
        self._tokens[key] = process
        self._tell_token(Token(key, True))

    def _tell_token(self, token: Token) -> None:
        for watcher in self._processes.values():
            if (pattern := first_match(watcher.watched, token.key)) is not None:
                self._reply(watcher, token, pattern)

    def _matching(self, key: str) -> list[str]:
        return [token for token in self._tokens if matches(key, token)]

    def _forget(self, process: Process) -> None:
        """Remove a process's subscriptions and tokens from the router."""
        process.registered.clear()
        process.watched.clear()
        self._routes.clear()
        for token in [token for token, holder in self._tokens.items() if holder is process]:
            del self._tokens[token]
            self._tell_token(Token(token, False))

    def _close_if(self, router: int) -> None:
        if router == self._routers:
            self._close()

    def _close(self) -> None:
        """End the router: processes see the others' tokens disappear, and a moment later lose their connection."""
        for token in self._tokens:
            self._tell_token(Token(token, False))
        for process in self._processes.values():
            cut_ns = process.from_router.arrival_ns(self.now_ns) + self._draw(_CUT_NS)
            self._at(cut_ns, partial(_cut, process, self._routers))
            process.registered.clear()
            process.watched.clear()
        self._open = False
        self._tokens.clear()
        self._routes.clear()


def _cut(process: Process, router: int) -> None:
    """Have a process notice that the router has gone, unless it is connected to another one by now."""
    if process.router == router:
        process.linked = False


def _refuse(effect: Effect) -> Event | None:
    raise TypeError(f"no one carries out {effect!r} here")
