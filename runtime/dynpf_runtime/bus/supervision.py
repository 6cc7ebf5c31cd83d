"""Supervision: what ``dynpf run`` makes of the processes that it has started; pure, with the time as an argument.

It looks at exit codes, at whether the system has stopped a process (SIGSTOP), and at pulses. A process that loads or
compiles has no pulse yet, and one that is in a node's step may be there for long: neither is taken for one that hangs.
"""

import signal
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from dynpf_protocol.control import Doing
from dynpf_protocol.errors import BROKEN_OFF
from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_runtime.bus.pulse import Reading
from dynpf_runtime.machines.heartbeats import STEP_NS, WEDGED_NS

__all__ = ["Act", "Asked", "Finish", "Kill", "Restart", "Say", "Seen", "Supervision", "Terminate"]

SECOND_NS = 1_000_000_000

STOPPED_NS = 1_000_000_000
"""How long the system may keep a process stopped before the run cannot go on."""

HELD_NS = 10_000_000_000
"""How long a process may wait for the bus: longer than the bus itself waits for anybody."""

NOTICE_NS = 10_000_000_000
"""After this, and then ever twice as long, a notice says who is still starting."""

GRACE_NS = 2_500_000_000
"""How long the other processes may take to stop by themselves after one has failed."""

LEFT_NS = 5_000_000_000
"""How long no process may end, after some have broken off without one that failed, until those left are killed."""

STALLED_NS = 1_500_000_000
"""How long, after the user has asked the run to stop, no process may do anything until those left are killed."""


class Seen(NamedTuple):
    """One process as its parent sees it."""

    exit_code: int | None  # None while it runs, negative for the signal that killed it
    stopped: bool  # by a signal such as SIGSTOP
    pulse: Reading


class Asked(NamedTuple):
    """What the user asks for: to end the run, with a reason, and whether at once."""

    reason: str = ""
    at_once: bool = False


class Say(NamedTuple):
    """Print a notice for the user."""

    text: str


class Terminate(NamedTuple):
    """Ask a process to end."""

    name: str


class Kill(NamedTuple):
    """End a process that hangs."""

    name: str


class Restart(NamedTuple):
    """Start a process again that has ended."""

    name: str


class Finish(NamedTuple):
    """Kill all that is left and end, with ``failure`` if the run has failed.

    ``died_again`` names a process that has died by itself twice in the same step, and that step's tick.
    """

    failure: str = ""
    died_again: tuple[str, int] | None = None


Act = Say | Terminate | Kill | Restart | Finish


class Supervision:
    """Watches the processes ``names`` of a run; ``look`` is called many times a second until it returns Finish.

    A process that was killed or hangs is started again, at most ``restarts`` times, unless it dies twice by itself in
    the same step.
    """

    def __init__(self, names: tuple[str, ...], restarts: int = 0) -> None:
        self._restarts = restarts
        self._started: Counter[str] = Counter()  # how often a process has been started again
        self._died_in: dict[str, int] = {}  # a process -> the tick of the step in which it died by itself
        self._died_again: tuple[str, int] | None = None
        self._failed = ""
        self._deadline_ns: int | None = None
        self._asked = False
        self._router_asked = False
        self._left = len(names)
        self._stopped_ns: dict[str, int] = {}
        self._killed: set[str] = set()
        self._notice_ns: dict[str, int] = {}  # a process -> after which time the next notice is due
        self._turns: dict[str, int] = {}
        self._moved_ns = 0  # when a process that is needed for the end last did something

    def look(self, seen: Mapping[str, Seen], asked: Asked, now_ns: int) -> Iterator[Act]:
        """Yield what is to be done."""
        running = [name for name, one in seen.items() if one.exit_code is None]
        if not running:
            yield Finish(self._verdict(seen, asked), self._died_again)
            return
        yield from self._hangs(seen, now_ns)
        if not asked.reason:
            yield from self._watch(seen, running, now_ns)
        elif not self._asked:
            self._asked, self._moved_ns = True, now_ns
            yield Say(f"{asked.reason}: ending the run (again to end it at once)")
            for name in running:
                yield Terminate(name)
        if running == [ROUTER] and not self._router_asked and (self._asked or self._deadline_ns is not None):
            self._router_asked = True
            yield Terminate(ROUTER)  # it waits for a run that will not begin
        left = ", ".join(running)
        if asked.at_once:
            yield Finish(f"{self._failed or asked.reason}; killed what was left: {left}")
        elif self._deadline_ns is not None and now_ns > self._deadline_ns:
            over = not asked.reason and self._over(seen)
            text = "" if over else f"{self._failed or 'the run has broken off'}; killed what was left: {left}"
            yield Finish(text, self._died_again)
        elif self._asked and self._stalls(seen, running, now_ns):
            yield Finish(f"{self._failed or asked.reason}; the run did not go on, killed what was left: {left}")

    def _watch(self, seen: Mapping[str, Seen], running: list[str], now_ns: int) -> Iterator[Act]:
        """Start again who was killed, or find that the run has failed."""
        if self._over(seen):
            self._deadline_ns = self._deadline_ns or now_ns + GRACE_NS
            return
        again = [name for name, one in seen.items() if (one.exit_code or 0) < 0 and self._may_again(name, one)]
        for name in again:
            yield from self._again(name, seen[name])
        if not again:
            yield from self._breaks(seen, running, now_ns)

    def _hangs(self, seen: Mapping[str, Seen], now_ns: int) -> Iterator[Act]:
        """Name and kill a process that hangs, and tell of one that takes long."""
        for name, one in seen.items():
            if one.exit_code is not None or name in self._killed:
                continue
            hang = self._stopped(name, stopped=one.stopped, now_ns=now_ns) or _stands_still(one.pulse, now_ns)
            if not hang:
                yield from self._takes_long(name, one.pulse, now_ns)
                continue
            text = f"{name} hangs: {hang}"
            self._killed.add(name)
            if self._restarts and not self._failed and self._started[name] < self._restarts:
                yield Say(text)
                yield Kill(name)
                continue
            self._failed = self._failed or text
            self._deadline_ns = min(self._deadline_ns or now_ns + GRACE_NS, now_ns + GRACE_NS)
            yield Say(f"{text}; the run cannot go on")
            yield Kill(name)  # so that nobody waits for it
            if self._restarts:
                for other in seen.keys() - {name}:
                    yield Terminate(other)

    def _over(self, seen: Mapping[str, Seen]) -> bool:
        """Return whether the run is recorded to its end: who was killed since then is of no matter."""
        nodes = [one.exit_code for name, one in seen.items() if name not in (ROUTER, RECORDER)]
        recorder = seen[RECORDER].exit_code or 0
        recorded = seen[RECORDER].exit_code == 0 or (all(code == 0 for code in nodes) and recorder <= 0)
        return bool(self._restarts) and not self._failed and recorded

    def _may_again(self, name: str, one: Seen) -> bool:
        """Return whether a process that was killed by a signal is to be started again."""
        died = -(one.exit_code or 0) in _BY_ITSELF and one.pulse.doing is Doing.STEP
        if died and self._died_in.get(name) == one.pulse.tick:
            self._died_again = name, one.pulse.tick
            self._failed = (
                f"{name} has died twice in the step of tick {one.pulse.tick} by signal {-(one.exit_code or 0)}"
            )
        if died:
            self._died_in[name] = one.pulse.tick
        return not self._failed and self._started[name] < self._restarts

    def _again(self, name: str, one: Seen) -> Iterator[Act]:
        self._started[name] += 1
        self._killed.discard(name)
        self._stopped_ns.pop(name, None)
        count = f"{self._started[name]} of at most {self._restarts}"
        yield Say(f"{name} was killed by signal {-(one.exit_code or 0)}; starting it again ({count})")
        yield Restart(name)

    def _stopped(self, name: str, *, stopped: bool, now_ns: int) -> str:
        if not stopped:
            self._stopped_ns.pop(name, None)
            return ""
        since_ns = self._stopped_ns.setdefault(name, now_ns)
        return "a signal has stopped it (SIGSTOP)" if now_ns - since_ns >= STOPPED_NS else ""

    def _takes_long(self, name: str, pulse: Reading, now_ns: int) -> Iterator[Act]:
        """Tell of a process that is still starting; of long steps the recorder tells."""
        lasted_ns = now_ns - pulse.since_ns
        if pulse.doing is Doing.STARTING and lasted_ns >= self._notice_ns.get(name, NOTICE_NS):
            self._notice_ns[name] = 2 * lasted_ns
            yield Say(f"{name} has been starting for {lasted_ns // SECOND_NS} s")

    def _breaks(self, seen: Mapping[str, Seen], running: list[str], now_ns: int) -> Iterator[Act]:
        """Name at once who was killed, and set the deadline for those left when a process has failed or broken off."""
        failure = _failure(seen)
        if failure and self._deadline_ns is None:
            self._failed = self._failed or failure
            failure = self._failed
            self._deadline_ns = now_ns + GRACE_NS
            if any((one.exit_code or 0) < 0 for one in seen.values()):  # who ends by itself tells why
                yield Say(f"{failure}; the run cannot go on")
            if self._restarts:  # the others wait for it
                for name in running:
                    yield Terminate(name)
        elif not self._failed and len(running) < self._left and any(one.exit_code for one in seen.values()):
            self._deadline_ns = now_ns + LEFT_NS
        self._left = len(running)

    def _stalls(self, seen: Mapping[str, Seen], running: list[str], now_ns: int) -> bool:
        """Return whether nothing has come closer to the run's end for some time: no step, no process that ended."""
        steps = {name: one.pulse.tick for name, one in seen.items()} | {"": len(running)}
        busy = any(seen[name].pulse.doing in (Doing.STEP, Doing.FILE) for name in running)
        if busy or steps != self._turns:
            self._turns, self._moved_ns = steps, now_ns
        return now_ns - self._moved_ns > STALLED_NS

    def _verdict(self, seen: Mapping[str, Seen], asked: Asked) -> str:
        """Return what has failed, when all have ended; empty if nothing has."""
        if self._failed:
            return self._failed
        if self._over(seen) and not asked.reason:
            return ""
        if asked.reason:
            return "" if seen["recorder"].exit_code == 0 else f"{asked.reason} before the run had begun"
        if failure := _failure(seen):
            return failure
        broken = [name for name, one in seen.items() if one.exit_code]
        return f"{', '.join(broken)} broke off" if broken else ""


_BY_ITSELF = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL)
"""Signals by which a process dies of what it does, not of what is done to it."""

_HELD = {
    Doing.BUS: "waiting for the bus",
    Doing.STEP: "in the step of tick {tick}",
    Doing.FILE: "waiting for its disk",
}


def _stands_still(pulse: Reading, now_ns: int) -> str:
    """Return how a main loop stands still for too long, or an empty text."""
    lasted_ns = now_ns - pulse.since_ns
    limits = {Doing.TURNING: WEDGED_NS, Doing.BUS: HELD_NS, Doing.STEP: STEP_NS, Doing.FILE: STEP_NS}
    if lasted_ns <= limits.get(pulse.doing, lasted_ns):
        return ""
    if pulse.doing is Doing.TURNING:
        return f"its main loop has stood still for {lasted_ns / SECOND_NS:.1f} s"
    return f"it has been {_HELD[pulse.doing].format(tick=pulse.tick)} for {lasted_ns // SECOND_NS} s"


def _failure(seen: Mapping[str, Seen]) -> str:
    """Return a sentence on the process that failed first, empty while processes have ended only because of others.

    A killed process is the cause, whatever the exit codes of the others.
    """
    codes = {name: one.exit_code or 0 for name, one in seen.items()}
    for name, code in codes.items():
        if code < 0:
            return f"{name} was killed by signal {-code}"
    for name, code in codes.items():
        if code not in (0, BROKEN_OFF):
            return f"{name} ended with exit code {code}"
    return ""
