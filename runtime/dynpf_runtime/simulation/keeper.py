"""The keeper: starts again whoever was killed or hangs, as a supervisor with a budget of restarts does."""

from collections import Counter
from collections.abc import Callable

from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_runtime.machines.heartbeats import WEDGED_NS
from dynpf_runtime.simulation.network import Simulation
from dynpf_runtime.simulation.process import KILLED, Process

__all__ = ["NAME", "RESTARTS", "Keeper"]

NAME = "keeper"
"""What it is called in the story."""

RESTARTS = 3
"""How often each process is started again."""

POLL_NS = 20_000_000
STOPPED_NS = 1_000_000_000
"""How long a signal may keep a process stopped before it is killed."""

GRACE_NS = 5_000_000_000
"""How long the others may take to end after one cannot be started again."""


class Keeper:
    """Keeps the processes of a simulation running; ``start_again`` starts one by its name.

    ``failure`` says, once all have ended, why the run has failed: an empty text if it has not, None before.
    ``exhausted`` says that a process was killed more often than it may be started again.
    """

    def __init__(self, simulation: Simulation, start_again: Callable[[str], None]) -> None:
        self.failure: str | None = None
        self.exhausted = False
        self._simulation = simulation
        self._start_again = start_again
        self._starts: Counter[str] = Counter()
        self._stopped_ns: dict[str, int] = {}
        self._failed = ""
        self._deadline_ns: int | None = None
        simulation.watched = True
        simulation.later(POLL_NS, self._look)

    def interrupt(self, *, at_once: bool) -> None:
        """Ask the run to end, as Ctrl-C does, and twice at once."""
        for name, process in self._simulation.processes.items():
            if process.running:
                self._simulation.ask_to_stop(name, "stopped by the user", at_once=at_once)
        self._fail("stopped by the user")

    def _look(self) -> None:
        simulation = self._simulation
        running = [process for process in simulation.processes.values() if process.running]
        for process in running:
            if hang := self._hangs(process):
                simulation.tell(NAME, f"{process.name} hangs: {hang}")
                simulation.kill(process.name)
        over = simulation.processes[RECORDER].exit_code == 0
        for name, process in list(simulation.processes.items()):
            if process.exit_code == KILLED and not over and not self._failed:
                self._keep(name)
            elif process.exit_code not in (None, 0, KILLED):
                self._fail(f"{name} has ended: {simulation.ended[name]}")
        if not any(process.running for process in simulation.processes.values()):
            self.failure = self._failed
            simulation.tell(NAME, self._failed or "finished")
            return
        late = self._deadline_ns is not None and simulation.now_ns > self._deadline_ns
        if late or (over and [process.name for process in running] == [ROUTER] and self._failed):
            for process in running:
                simulation.kill(process.name)
        simulation.later(POLL_NS, self._look)

    def _keep(self, name: str) -> None:
        if self._starts[name] == RESTARTS:
            self.exhausted = True
            self._fail(f"{name} was killed once more than it may be started again")
            return
        self._starts[name] += 1
        self._start_again(name)

    def _fail(self, failure: str) -> None:
        if not self._failed:
            self._failed = failure
            self._deadline_ns = self._simulation.now_ns + GRACE_NS
            if self._simulation.processes[RECORDER].running:
                self._simulation.ask_to_stop(RECORDER, failure, at_once=True)

    def _hangs(self, process: Process) -> str:
        now_ns = self._simulation.now_ns
        if not process.stopped:
            self._stopped_ns.pop(process.name, None)
        elif now_ns - self._stopped_ns.setdefault(process.name, now_ns) >= STOPPED_NS:
            return "a signal has stopped it"
        waited_ns = now_ns - process.turned_ns
        return f"its main loop has stood still for {waited_ns / 1e9:.1f} s" if waited_ns > WEDGED_NS else ""
