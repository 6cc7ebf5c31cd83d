"""Runs on a simulated network whose processes are killed and started again, as ``dynpf run`` does it."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import NamedTuple

from dynpf_protocol.keys import RECORDER, ROUTER
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation import Happened, Network, Simulation
from dynpf_runtime.source import LogRecord
from dynpf_services.recorder.host import RecorderFile

from tests.unit.machines.simulated_run import ENDPOINT, host_of, simulated

__all__ = ["NETWORK", "PATIENCE_NS", "Kill", "recovered"]

PATIENCE_NS = 30 * 10**9
NETWORK = Network(start_ns=30_000_000)
NOTICE_NS = 20_000_000
"""How long it takes until who watches the processes starts a killed one again."""

LIMIT_NS = 120 * 10**9


class Kill(NamedTuple):
    """A process, and when it is killed: before its so-manieth event or effect since it was started."""

    name: str
    after: int


class _Run:
    def __init__(self, files: ExitStack, plan: Plan, path: Path, log: Sequence[LogRecord]) -> None:
        self._files, self._plan, self._path, self._log = files, plan, path, log
        self._count = 1

    def start_again(self, simulation: Simulation, name: str) -> None:
        """Start a process again, under a name of its own."""
        self._count += 1
        start, plan = f"{name}-{self._count}", self._plan
        if name == ROUTER:
            simulation.restart(name, RouterMachine(plan, start))
        elif name == RECORDER:
            exists = self._path.exists()
            machine = RecorderMachine(plan, start, ENDPOINT, str(self._path), patience_ns=PATIENCE_NS, exists=exists)
            file = self._files.enter_context(RecorderFile(plan, start, self._path))
            simulation.restart(name, machine, file.perform)
        else:
            simulation.restart(name, host_of(name, plan, start, self._log, PATIENCE_NS))


def recovered(
    plan: Plan,
    path: Path,
    seed: int,
    kills: Iterable[Kill],
    *,
    network: Network = NETWORK,
    log: Sequence[LogRecord] = (),
    act: Callable[[Simulation, str], None] = Simulation.kill,
    begin: Callable[[Simulation], None] = lambda _: None,
) -> Simulation:
    """Return the simulation of a run after its end, some of whose processes were killed and started again.

    ``begin`` adds others to it. The next kill counts from when the process of the one before has been started again.
    """
    with ExitStack() as files:
        simulation = simulated(files, plan, path, seed, network=network, log=log, patience_ns=PATIENCE_NS)
        begin(simulation)
        run, waiting = _Run(files, plan, path, log), list(kills)
        counts: Counter[str] = Counter()

        def start_again(name: str) -> None:
            if simulation.ended.get(RECORDER, "runs") is not None:
                run.start_again(simulation, name)
                counts.clear()

        def watch(happened: Happened) -> None:
            counts[happened.process] += 1
            if waiting and happened.process == waiting[0].name and counts[happened.process] > waiting[0].after:
                kill = waiting.pop(0)
                act(simulation, kill.name)
                simulation.later(NOTICE_NS, partial(start_again, kill.name))

        simulation.watch = watch
        simulation.run(until=lambda: simulation.ended.get(RECORDER, "runs") is None, limit_ns=LIMIT_NS)
    return simulation
