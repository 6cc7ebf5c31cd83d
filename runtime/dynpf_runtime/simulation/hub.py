"""The hub: what the router's process knows of those connected to it, and passes on between them."""

from collections import defaultdict
from collections.abc import Callable
from random import Random
from typing import Protocol

from dynpf_runtime.machines.events import Arrived, Event, Token
from dynpf_runtime.simulation.keys import first_match, matches
from dynpf_runtime.simulation.process import Process

__all__ = ["Hub"]


class Reply(Protocol):
    """Sends an event to a process, where the thread of the subscription ``pattern`` takes it."""

    def __call__(self, process: Process, event: Event, pattern: str = "") -> None: ...


class Hub:
    """Subscriptions, tokens and answers of ``processes``; ``reply`` sends an event to one of them.

    While it is ``stopped``, what comes to it waits; once it is ``gone``, what comes to it is lost.
    """

    def __init__(self, processes: dict[str, Process], reply: Reply, random: Random) -> None:
        self.gone = False
        self.stopped = False
        self._processes = processes
        self._reply = reply
        self._random = random
        self._waiting: list[Callable[[], None]] = []
        self._tokens: dict[str, Process] = {}
        self._answers: defaultdict[str, list[bytes]] = defaultdict(list)
        self._routes: dict[str, list[tuple[Process, str]]] = {}  # key -> who subscribes to it, and by which pattern

    def take(self, act: Callable[[], None]) -> None:
        """Do what a process has asked for."""
        if self.stopped and not self.gone:
            self._waiting.append(act)
        elif not self.gone:
            act()

    def go_on(self) -> None:
        """Do what has come meanwhile."""
        self.stopped = False
        waiting, self._waiting = self._waiting, []
        for act in waiting:
            self.take(act)

    def route(self, arrived: Arrived, but: Process | None) -> None:
        """Pass a message on to all who subscribe to its key, except the one that has sent it."""
        receivers = self._routes.get(arrived.key)
        if receivers is None:
            receivers = [
                (process, pattern)
                for process in self._processes.values()
                if (pattern := first_match(process.registered, arrived.key)) is not None
            ]
            self._routes[arrived.key] = receivers
        for receiver, pattern in receivers:
            if receiver is not but:
                self._reply(receiver, arrived, pattern)

    def offer(self, key: str, payload: bytes) -> None:
        """Answer queries with a payload."""
        self._answers[key].append(payload)

    def answer(self, key: str, wanted: bytes) -> bytes | None:
        """Return the wanted answer if anybody gives it, else one by chance."""
        answers = self._answers[key]
        if wanted in answers or not answers:
            return wanted if answers else None
        return self._random.choice(answers)

    def matching(self, key: str) -> tuple[str, ...]:
        """Return the tokens that match a key, in order."""
        return tuple(sorted(token for token in self._tokens if matches(key, token)))

    def subscribe(self, process: Process, key: str) -> None:
        """Register a subscription."""
        process.registered.append(key)
        self._routes.clear()

    def watch(self, process: Process, key: str) -> None:
        """Tell a process of the tokens that match, those of now and of later."""
        process.watched.append(key)
        for token in self.matching(key):
            self._reply(process, Token(token, True), key)

    def declare(self, process: Process, key: str) -> None:
        """Add a token of a process's."""
        self._tokens[key] = process
        self._tell(Token(key, True))

    def forget(self, process: Process) -> None:
        """Remove a process's subscriptions and tokens."""
        process.registered.clear()
        process.watched.clear()
        self._routes.clear()
        for token in [token for token, holder in self._tokens.items() if holder is process]:
            del self._tokens[token]
            self._tell(Token(token, False))

    def close(self) -> None:
        """Forget everything; processes see the others' tokens disappear."""
        for token in self._tokens:
            self._tell(Token(token, False))
        self.gone = True
        self._waiting.clear()
        self._tokens.clear()
        self._answers.clear()

    def _tell(self, token: Token) -> None:
        for watcher in self._processes.values():
            if (pattern := first_match(watcher.watched, token.key)) is not None:
                self._reply(watcher, token, pattern)
