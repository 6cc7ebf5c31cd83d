"""The watch: the supervision of ``dynpf run`` on simulated processes."""

from collections import Counter
from collections.abc import Callable, Mapping

from dynpf_protocol.control import Doing
from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_runtime.bus.pulse import Reading
from dynpf_runtime.bus.supervision import Asked, Finish, Kill, Restart, Say, Seen, Supervision, Terminate
from dynpf_runtime.simulation.network import Simulation
from dynpf_runtime.simulation.process import KILLED, Process

__all__ = ["NAME", "Watch"]

NAME = "run"
"""What the watching process is called in the story."""

POLL_NS = 20_000_000

CLOSE_NS = 1_000_000_000
"""How long the recorder may take to close its file before it is killed."""

_STOP = "stopped by the user"


class Watch:
    """Watches the processes of a simulation as ``dynpf run`` does; ``ticks`` has the last step begun of each.

    Who was killed is started again by ``start``, at most ``restarts`` times. ``failure`` says, once all have ended, why
    the run has failed: an empty text if it has not, None before. ``exhausted`` says that a process was killed more
    often than that. ``waited`` names those who neither hung nor were cut off when they had to be killed in the end.
    """

    def __init__(
        self, simulation: Simulation, ticks: Mapping[str, int], restarts: int, start: Callable[[str], None]
    ) -> None:
        self.failure: str | None = None
        self.exhausted = False
        self.waited: list[str] = []
        self._simulation = simulation
        self._ticks = ticks
        self._restarts = restarts
        self._start = start
        self._started: Counter[str] = Counter()
        self._supervision = Supervision(tuple(simulation.processes), restarts)
        self._asked = Asked()
        simulation.be_watched(True)
        simulation.later(POLL_NS, self._look)

    def interrupt(self, *, at_once: bool) -> None:
        """Ask the run to end, as Ctrl-C does, and twice at once."""
        self._asked = Asked(_STOP, at_once)

    def _look(self) -> None:
        simulation = self._simulation
        now_ns = simulation.now_ns
        seen = {name: self._seen(process, now_ns) for name, process in simulation.processes.items()}
        for act in self._supervision.look(seen, self._asked, now_ns):
            match act:
                case Say(text):
                    simulation.tell(NAME, text)
                case Terminate(name):
                    simulation.ask_to_stop(name, _STOP)
                case Kill(name):
                    simulation.kill(name)
                case Restart(name):
                    self._started[name] += 1
                    self._start(name)
                case Finish(failure):
                    self._finish(failure)
                    return
        simulation.later(POLL_NS, self._look)

    def _seen(self, process: Process, now_ns: int) -> Seen:
        started = process.events > 0 or now_ns > process.began_ns
        reading = Reading(
            Doing.TURNING if started else Doing.STARTING,
            process.turned_ns,
            self._ticks.get(process.name, 0),
            process.events,
        )
        return Seen(process.exit_code, process.stopped, reading)

    def _finish(self, failure: str) -> None:
        """Kill all that is left: the recorder, which first may close its file, and the router come last."""
        simulation = self._simulation
        self.failure = failure
        processes = simulation.processes.items()
        killed = [name for name, process in processes if process.exit_code == KILLED]
        self.waited = [name for name, one in processes if one.running and not one.hangs and one.connection]
        self.exhausted = any(self._started[name] == self._restarts for name in killed)
        simulation.tell(NAME, failure or "finished")
        recorder = simulation.processes[RECORDER]
        for name, process in simulation.processes.items():
            if name not in (ROUTER, RECORDER) and process.running:
                simulation.kill(name)
        if recorder.running:
            simulation.ask_to_stop(RECORDER, _STOP, at_once=bool(self._asked.reason))
        simulation.later(CLOSE_NS if recorder.running else 0, self._kill_rest)

    def _kill_rest(self) -> None:
        for name, process in self._simulation.processes.items():
            if process.running:
                self._simulation.kill(name)
        self._simulation.be_watched(False)
