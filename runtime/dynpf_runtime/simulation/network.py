"""The network: processes around one router, connected as by Zenoh, under a seed and a clock of their own.

Every message goes to the router and from there to the subscribers, each connection keeps the order and delays messages
at random. Liveliness tokens and queries take the same connections. In a process each subscription has a thread of its
own, so that only what comes by one subscription keeps its order. Two simulations of the same machines under the same
seed give the same story.
"""

from collections import Counter, defaultdict
from collections.abc import Callable
from functools import partial
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
    Woke,
)
from dynpf_runtime.simulation.agenda import Agenda
from dynpf_runtime.simulation.connections import LEASE_NS, Connections
from dynpf_runtime.simulation.process import KILLED, RETRY_NS, Closing, Killed, Link, Network, Perform, Process

__all__ = ["EPOCH_NS", "LEASE_NS", "Happened", "Network", "Simulation"]

EPOCH_NS = 1_700_000_000 * 10**9
"""The wall clock's time at the beginning, ns."""


class Happened(NamedTuple):
    """One event or effect of a process, or what befell it as a text, and its time."""

    at_ns: int
    process: str
    what: Event | Effect | str


_NETWORK = Network()
_OF_THE_BUS = frozenset((Subscribe, Watch, Declare, Answer, Ask, Count))


class Simulation:
    """Processes by name, connected through the one named ``router``.

    ``story`` lists what has happened so far, ``ended`` the processes that have ended by themselves, each with its
    error. ``watch`` sees all that happens, and may kill a process before it has done an effect. ``wall_ns`` is how far
    the wall clock has been put forward.
    """

    def __init__(self, seed: int, router: str, network: Network = _NETWORK) -> None:
        self.story: list[Happened] = []
        self.ended: dict[str, BaseException | None] = {}
        self.watch: Callable[[Happened], None] | None = None
        self.wall_ns = 0
        self._watched = False
        self.processes: dict[str, Process] = {}
        self._random = Random(seed)
        self._router = router
        self._network = network
        self._agenda = Agenda(self._random)
        self._bus = Connections(self.processes, router, self._agenda, network, arrive=self._arrive, tell=self.tell)
        self._changed = True  # whether a process has ended, hangs, or goes on since ``going`` was looked at
        self._befalls: defaultdict[tuple[str, int], list[Callable[[], None]]] = defaultdict(list)

    def add(self, name: str, machine: Machine, perform: Perform | None = None, closing: Closing | None = None) -> None:
        """Start a process after a random delay; ``perform`` carries out effects that do not concern the bus.

        ``closing`` is called with the process's error, or None, when it ends by itself.
        """
        if name in self.processes:
            raise ValueError(f"there is a process {name!r} already; give the second one another name")
        self._start(name, machine, perform, closing)

    def restart(
        self, name: str, machine: Machine, perform: Perform | None = None, closing: Closing | None = None
    ) -> None:
        """Start a process again, after ending the one that has its name; those connected find a new router."""
        if self.processes[name].running:
            self.kill(name)
        self.ended.pop(name, None)
        self.tell(name, "is started again")
        process = self._start(name, machine, perform, closing)
        if name == self._router:
            self._bus.reopen(process)

    def _start(self, name: str, machine: Machine, perform: Perform | None, closing: Closing | None) -> Process:
        delay_ns = 0 if name == self._router else self._network.delay_ns
        links = [Link(self._random, delay_ns) for _ in range(2)]
        before = self.processes.get(name)
        process = self.processes[name] = Process(name, machine, perform or _refuse, links, closing)
        if before is not None:
            process.events, process.arrivals = before.events, before.arrivals
            process.most_idle_wakes = before.most_idle_wakes
        process.began_events = process.events
        process.busy_ns = process.began_ns = process.turned_ns = self.now_ns + self._agenda.draw(self._network.start_ns)
        self._changed = True
        self._plan(process)
        return process

    def run(self, until: Callable[[], bool] | None = None, limit_ns: int = 600 * 10**9) -> None:
        """Run until every process has ended or hangs, or ``until`` is true; raises TimeoutError at ``limit_ns``."""
        agenda = self._agenda
        while agenda and not (until is not None and until()):
            if self._changed:
                if not self.going:
                    return
                self._changed = False
            if agenda.next_ns > limit_ns:
                raise TimeoutError(f"the run has not ended after {limit_ns / 1e9:g} simulated seconds")
            agenda.step()

    @property
    def now_ns(self) -> int:
        """The simulated time."""
        return self._agenda.now_ns

    @property
    def published(self) -> Counter[str]:
        """How many messages processes have published, by key."""
        return self._bus.published

    @property
    def lost(self) -> Callable[[str, Arrived], bool]:
        """Decides for each message from the router to a process whether it is lost."""
        return self._bus.lost

    @lost.setter
    def lost(self, lost: Callable[[str, Arrived], bool]) -> None:
        self._bus.lost = lost

    @property
    def going(self) -> bool:
        """Whether some process is still to do something, or to be killed by the one that watches it."""
        return self._watched or any(process.alive for process in self.processes.values())

    def be_watched(self, watched: bool) -> None:
        """Note whether somebody kills those that hang: then the simulation goes on as long as that one does."""
        self._watched, self._changed = watched, True

    def befall(self, name: str, event: int, act: Callable[[], None]) -> None:
        """Call ``act`` just before a process handles its event with this number, from 0."""
        self._befalls[name, event].append(act)

    def deliver(self, name: str, message: int, *copies: tuple[int, int]) -> None:
        """Deliver the message with this number, from 0, to a process once for each of ``copies``.

        A copy is by how many nanoseconds the connection is late, and by how many the thread of its subscription.
        """
        self._bus.late[name, message] = copies

    def later(self, delay_ns: int, act: Callable[[], None]) -> None:
        """Call ``act`` after a time."""
        self._agenda.at(self.now_ns + delay_ns, act)

    def tell(self, name: str, text: str) -> None:
        """Add to the story what befalls a process."""
        self.story.append(Happened(self.now_ns, name, text))

    def kill(self, name: str, effects: int = 0, unsent: int = 0) -> None:
        """End a process at once, or after as many effects of the event that it is about to handle.

        Messages that it has already sent still arrive, but for the last ``unsent``, which are still in its memory.
        """
        process = self.processes[name]
        if effects:
            process.doomed = effects, unsent
        elif process.running:
            for sending in list(process.unsent)[len(process.unsent) - min(unsent, len(process.unsent)) :]:
                sending.clear()
            process.exit_code = KILLED
            self.tell(name, "is killed")
            self._leave(process)

    def hang(self, name: str, for_ns: int = NEVER_NS) -> None:
        """Make a process stop handling events, for ever or for a time, while it stays connected."""
        process = self.processes[name]
        if not process.running or process.hangs:
            return
        process.hangs = self._changed = True
        self.tell(name, "hangs")
        if for_ns < NEVER_NS:
            process.resumes_ns = self.now_ns + for_ns
            self._agenda.at(process.resumes_ns, lambda: self._resume(process))

    def freeze(self, name: str, for_ns: int = NEVER_NS) -> None:
        """Stop a process as SIGSTOP does: it does nothing any more, and its connection is dropped after the lease."""
        process = self.processes[name]
        if not process.running or process.hangs:
            return
        self.hang(name, for_ns)
        process.stopped = True
        self._bus.hub.stopped = self._bus.hub.stopped or name == self._router
        if for_ns >= LEASE_NS:
            self._agenda.at(
                self.now_ns + LEASE_NS, partial(self._bus.close if name == self._router else self._bus.part, process)
            )

    def cut(self, name: str, for_ns: int) -> None:
        """Cut a process off from the router; nothing is lost if the connection is there again within the lease."""
        process = self.processes[name]
        if not process.running or name == self._router:
            return
        self.tell(name, "is cut off")
        process.cut_ns = max(process.cut_ns, self.now_ns + for_ns)
        for link in (process.to_router, process.from_router):
            link.stall(process.cut_ns)
        if for_ns >= LEASE_NS:
            self._agenda.at(self.now_ns + LEASE_NS, partial(self._bus.part, process))

    def slow(self, name: str, events: int, each_ns: int) -> None:
        """Make a process take longer for its next events."""
        self.processes[name].slow = events, each_ns

    def ask_to_stop(self, name: str, reason: str, *, at_once: bool = False) -> None:
        """Act like a signal to a process."""
        self._arrive(self.processes[name], StopAsked(reason, at_once))

    def publish(self, key: str, payload: bytes, attachment: bytes = b"") -> None:
        """Publish as a stranger, not as a process of the run."""
        self._bus.hub.route(Arrived(key, payload, attachment), but=None)

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
        self._agenda.at(due_ns, lambda: self._serve(process, due_ns))

    def _serve(self, process: Process, planned_ns: int) -> None:
        if not process.running or process.hangs or planned_ns != process.planned_ns:
            return  # it has been rescheduled
        process.planned_ns = NEVER_NS
        if self._bus.hub.gone and process.inbox and type(process.inbox[0]) is Started and process.name != self._router:
            self._await_router(process)
            return
        if process.inbox and type(process.inbox[0]) is Started:
            self._bus.connect(process)
        if self._befalls and (acts := self._befalls.pop((process.name, process.events), None)) is not None:
            for act in acts:
                act()
            if not process.running or process.hangs:
                return
        if process.inbox:
            self._handle(process, process.inbox.popleft())
        elif self.now_ns >= process.machine.wake_ns:
            self._wake(process)
        process.busy_ns = self.now_ns + 1 + self._agenda.draw(self._network.work_ns)
        if process.slow[0]:
            process.busy_ns += process.slow[1]
            process.slow = process.slow[0] - 1, process.slow[1]
        self._plan(process)

    def _wake(self, process: Process) -> None:
        if not process.linked:
            self._handle(process, RouterGone())
        length = len(self.story)
        self._handle(process, Woke())
        idle = len(self.story) == length + 1 and process.machine.wake_ns <= self.now_ns
        process.idle_wakes = process.idle_wakes + 1 if idle else 0
        process.most_idle_wakes = max(process.most_idle_wakes, process.idle_wakes)

    def _await_router(self, process: Process) -> None:
        """Let a new process look for the router again in a while, unless it is asked to end."""
        if any(type(event) is StopAsked for event in process.inbox):
            self._end(process, KeyboardInterrupt())
            return
        if process.tells_of_router(self.now_ns):
            self._note(process, Tell("waiting for the router"))
        process.busy_ns = process.turned_ns = self.now_ns + RETRY_NS
        self._plan(process)

    def _handle(self, process: Process, event: Event) -> None:
        if not process.running:
            return
        process.events += 1
        process.turned_ns = self.now_ns
        self._note(process, event)
        try:
            for effect in process.machine.handle(event, Now(self.now_ns, EPOCH_NS + self.wall_ns + self.now_ns)):
                self._note(process, effect)
                if process.running:
                    self._do(process, effect)
                if process.doomed is not None:
                    self._doom(process, process.doomed)
                if not process.running:
                    return
        except Killed:
            self.kill(process.name)
        except Exception as error:  # it would end a real process, too
            self._end(process, error)
        if process.doomed is not None and process.running:
            self.kill(process.name, unsent=process.doomed[1])

    def _note(self, process: Process, what: Event | Effect) -> None:
        happened = Happened(self.now_ns, process.name, what)
        self.story.append(happened)
        if self.watch is not None:
            self.watch(happened)

    def _doom(self, process: Process, doomed: tuple[int, int]) -> None:
        effects, unsent = doomed
        process.doomed = effects - 1, unsent
        if effects == 1:
            self.kill(process.name, unsent=unsent)

    def _do(self, process: Process, effect: Effect) -> None:
        if type(effect) is Put:
            self._bus.put(process, Arrived(*effect))
        elif type(effect) in _OF_THE_BUS:
            self._ask(process, effect)
        elif type(effect) is Ended:
            self._end(process, effect.error)
        elif type(effect) is not Tell and (event := process.perform(effect)) is not None:  # the story has what is told
            process.inbox.appendleft(event)

    def _ask(self, process: Process, effect: Effect) -> None:
        """Carry out an effect that concerns the router."""
        match effect:
            case Subscribe(key):
                process.subscribed.append(key)
                process.hears.clear()
                self._bus.send(process, lambda: self._bus.hub.subscribe(process, key))
            case Watch(key):
                process.watches.append(key)
                self._bus.send(process, lambda: self._bus.hub.watch(process, key))
            case Declare(key):
                process.declared.append(key)
                self._bus.send(process, lambda: self._bus.hub.declare(process, key))
            case Answer(key, payload):
                process.offered.append((key, payload))
                self._bus.hub.offer(key, payload)
            case Ask(key, wanted):
                self._bus.query(process, lambda: Answered(self._bus.hub.answer(key, wanted)), Answered(None))
            case Count(key):
                self._bus.query(process, lambda: Counted(key, self._bus.hub.matching(key)), Counted(key, ()))

    def _end(self, process: Process, error: BaseException | None) -> None:
        self.ended[process.name] = error
        process.end(error)
        if process.closing is not None:
            process.closing(error)
        self._leave(process)

    def _leave(self, process: Process) -> None:
        process.running, self._changed = False, True
        if process.name == self._router:
            self._bus.close(process)
        else:
            self._bus.send(process, lambda: self._bus.hub.forget(process))

    def _resume(self, process: Process) -> None:
        """Let a process that hung go on."""
        if not process.running:
            return
        self.tell(process.name, "goes on")
        process.hangs = process.stopped = False
        self._changed = True
        process.resumes_ns = process.planned_ns = NEVER_NS
        if process.name == self._router:
            self._bus.hub.go_on()
            if self._bus.hub.gone:
                self._bus.reopen(process)
        elif not process.connection:
            self._bus.link_again(process)
        self._plan(process)

    def _arrive(self, process: Process, event: Event) -> None:
        if process.running:
            process.inbox.append(event)
            self._plan(process)


def _refuse(effect: Effect) -> Event | None:
    raise TypeError(f"no one carries out {effect!r} here")
