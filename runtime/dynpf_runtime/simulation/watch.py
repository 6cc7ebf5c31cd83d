"""The watch: the supervision of ``dynpf run`` on simulated processes."""

from collections.abc import Mapping

from dynpf_protocol.control import Doing
from dynpf_protocol.keys import RECORDER, ROUTER

from dynpf_runtime.bus.pulse import Reading
from dynpf_runtime.bus.supervision import Asked, Finish, Kill, Say, Seen, Supervision, Terminate
from dynpf_runtime.simulation.network import Simulation
from dynpf_runtime.simulation.process import Process

__all__ = ["NAME", "Watch"]

NAME = "run"
"""What the watching process is called in the story."""

POLL_NS = 20_000_000

CLOSE_NS = 1_000_000_000
"""How long the recorder may take to close its file before it is killed."""

_STOP = "stopped by the user"


class Watch:
    """Watches the processes of a simulation as ``dynpf run`` does; ``ticks`` has the last step begun of each.

    ``failure`` says, once all have ended, why the run has failed: an empty text if it has not, None before.
    """

    def __init__(self, simulation: Simulation, ticks: Mapping[str, int]) -> None:
        self.failure: str | None = None
        self._simulation = simulation
        self._ticks = ticks
        self._supervision = Supervision(tuple(simulation.processes))
        self._asked = Asked()
        simulation.watched = True
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
