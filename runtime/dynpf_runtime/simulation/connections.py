"""Connections: what travels between the processes of a simulation and the hub in its router's process."""

from collections import Counter
from collections.abc import Callable
from functools import partial

from dynpf_runtime.machines.events import Arrived, Event, Token
from dynpf_runtime.simulation.agenda import Agenda
from dynpf_runtime.simulation.hub import Hub
from dynpf_runtime.simulation.process import Link, Network, Process

__all__ = ["LEASE_NS", "Connections"]

LEASE_NS = 1_500_000_000
"""After so long without a word a connection is given up."""

_ANSWER_NS = 1_000_000_000  # after so long a query has no answer
_THREAD_NS = 200_000  # longest time from a message's arrival until the thread of its subscription has passed it on
_CUT_NS = 20_000_000  # longest time from the loss of the others' tokens until a process knows that the router is gone
_AGAIN_NS = 1_000_000_000  # longest time until a process that has lost the router finds it again

_Copies = tuple[tuple[int, int], ...]
_ONCE: _Copies = ((0, 0),)


class Connections:
    """The connections of ``processes`` to the one named ``router``.

    ``arrive`` takes an event for a process, ``tell`` what befalls a message. ``lost`` decides for each message from the
    router to a process whether it is lost; ``late`` has the copies of those that do not come once and at once, by
    process and number.
    """

    def __init__(
        self,
        processes: dict[str, Process],
        router: str,
        agenda: Agenda,
        network: Network,
        *,
        arrive: Callable[[Process, Event], None],
        tell: Callable[[str, str], None],
    ) -> None:
        self.hub = Hub(processes, self.reply, agenda.random)
        self.published: Counter[str] = Counter()
        self.lost: Callable[[str, Arrived], bool] = lambda _process, _arrived: False
        self.late: dict[tuple[str, int], _Copies] = {}
        self._processes = processes
        self._router = router
        self._agenda = agenda
        self._answer_ns = network.answer_ns
        self._arrive = arrive
        self._tell = tell
        self._count = 0  # of connections

    def part(self, process: Process) -> None:
        """Give up a connection that has been silent for the lease, on both sides."""
        if self.hub.gone or not (process.stopped or process.cut_ns > self._agenda.now_ns):
            return
        if not process.running:
            self.hub.forget(process)
            return
        for key in list(process.seen):
            self._deliver(process, process.partings, Token(key, False))
        self.hub.forget(process)
        process.linked, process.connection = False, 0
        if not process.stopped:
            process.partings += 1
            self._agenda.at(process.cut_ns, lambda: self.link_again(process))

    def close(self, router: Process) -> None:
        """End this router: processes see the others' tokens disappear, and a moment later lose their connection."""
        replaced = router is not self._processes[self._router]  # it was killed before it had been silent for the lease
        if self.hub.gone or replaced or (router.running and not self.hub.stopped):
            return
        self.hub.close()
        for process in self._processes.values():
            if process.name != self._router:
                process.connection = 0
                process.registered.clear()
                process.watched.clear()
            cut_ns = process.from_router.arrival_ns(self._agenda.now_ns) + self._agenda.draw(_CUT_NS)
            self._agenda.at(cut_ns, partial(_cut, process))

    def reopen(self, router: Process) -> None:
        """Let those connect again who have lost the router."""
        self.hub.gone = self.hub.stopped = False
        for token in router.declared:
            self.hub.declare(router, token)
        for key, payload in router.offered:
            self.hub.offer(key, payload)
        for process in self._processes.values():
            if process is not router:
                self.link_again(process)

    def connect(self, process: Process) -> None:
        """Connect a process."""
        self._count += 1
        process.connection, process.linked = self._count, True

    def link_again(self, process: Process) -> None:
        """Connect a process again after a while, and tell the router of its subscriptions and tokens."""
        self._agenda.at(
            self._agenda.now_ns + _CUT_NS + self._agenda.draw(_AGAIN_NS), lambda: self._declare_again(process)
        )

    def _declare_again(self, process: Process) -> None:
        if not process.running or process.hangs or self.hub.gone or process.connection:
            return
        self.connect(process)
        for key in process.subscribed:
            self.send(process, partial(self.hub.subscribe, process, key))
        for key in process.watches:
            self.send(process, partial(self.hub.watch, process, key))
        for key in process.declared:
            self.send(process, partial(self.hub.declare, process, key))

    def send(self, process: Process, act: Callable[[], None]) -> None:
        """Schedule what the router does for a process for when the process's word arrives there."""
        sending = [act]
        process.unsent.append(sending)
        connection = process.connection

        def arrive() -> None:
            if sending and connection and connection == process.connection:
                self.hub.take(sending[0])

        self._agenda.at(process.to_router.arrival_ns(self._agenda.now_ns), arrive)

    def reply(self, process: Process, event: Event, pattern: str = "") -> None:
        """Send an event from the router to a process, where the thread of the subscription ``pattern`` takes it."""
        copies: _Copies = _ONCE
        if type(event) is Arrived:
            if self.lost(process.name, event):
                return
            if self.late:
                copies = self.late.pop((process.name, process.arrivals), _ONCE)
                if copies is not _ONCE:
                    self._tell("fault", f"{event.key} to {process.name} {_how(copies)}")
            process.arrivals += 1
        if pattern not in process.threads:
            process.threads[pattern] = Link(self._agenda.random, _THREAD_NS)
        for link_ns, thread_ns in copies:
            on_link_ns = process.from_router.arrival_ns(self._agenda.now_ns, link_ns)
            at_ns = process.threads[pattern].arrival_ns(on_link_ns, thread_ns)
            self._agenda.at(at_ns, partial(self._deliver, process, process.partings, event))

    def _deliver(self, process: Process, partings: int, event: Event) -> None:
        if partings != process.partings:
            return  # it was lost with the connection
        if type(event) is Token:
            process.seen.pop(event.key, None)
            process.seen.update({event.key: None} if event.present else {})
        self._arrive(process, event)

    def query(self, process: Process, reply: Callable[[], Event], none: Event) -> None:
        """Ask the router, and answer with ``none`` if it does not answer in time."""
        waiting = [True]

        def answer(event: Event) -> None:
            if waiting:
                waiting.clear()
                self._arrive(process, event)

        def answered() -> None:
            event = reply()
            late_ns = self._agenda.draw(self._answer_ns) if self._answer_ns else 0
            self._agenda.at(process.from_router.arrival_ns(self._agenda.now_ns) + late_ns, lambda: answer(event))

        self.send(process, answered)
        self._agenda.at(self._agenda.now_ns + _ANSWER_NS, lambda: answer(none))

    def put(self, process: Process, arrived: Arrived) -> None:
        """Publish a message of a process's."""
        self.published[arrived.key] += 1
        if process.hears_itself(arrived.key):
            self._arrive(process, arrived)  # as in Zenoh, a process's own messages come back at once
        self.send(process, lambda: self.hub.route(arrived, process))


def _how(copies: _Copies) -> str:
    """Return what happens to a message that comes as these copies."""
    if not copies:
        return "is lost"
    late_ns = max(map(sum, copies))
    return f"comes {'twice' if len(copies) > 1 else 'late'}, by {late_ns / 1e6:g} ms"


def _cut(process: Process) -> None:
    """Have a process notice that it has lost the router, unless it is connected again by now."""
    if not process.connection:
        process.linked = False
