"""Whole runs on a simulated network: router, recorder and nodes of a plan, as their processes would be."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from dynpf_formats.recording.header import Attachment
from dynpf_protocol.keys import RECORDER, ROUTER
from dynpf_runtime.machines.node_host import NodeHost
from dynpf_runtime.machines.recorder import RecorderMachine
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.plan import Plan
from dynpf_runtime.simulation import Network, Simulation
from dynpf_runtime.source import LogRecord
from dynpf_services.recorder.host import RecorderFile, recorded_boots

__all__ = ["host_of", "simulated"]

ENDPOINT = "tcp/simulated:1"
NETWORK = Network()


class Still:
    """No time passes, and nothing waits: what a host reports of itself says nothing."""

    def stepping(self, tick: int) -> None:
        pass

    def stopwatch_s(self) -> float:
        return 0.0

    def waiting(self) -> int:
        return 0


def host_of(name: str, plan: Plan, start: str, log: Sequence[LogRecord] = (), patience_ns: int = 0) -> NodeHost:
    """Return the machine of a node's process."""
    node = plan.graph.specs[name].build()
    return NodeHost(name, node, plan, start, endpoint=ENDPOINT, log=log, gauges=Still(), patience_ns=patience_ns)


def simulated(
    files: ExitStack,
    plan: Plan,
    path: Path,
    seed: int = 1,
    *,
    log: Sequence[LogRecord] = (),
    attachments: Sequence[Attachment] = (),
    without: Sequence[str] = (),
    network: Network = NETWORK,
    patience_ns: int = 0,
    resume: bool = False,
) -> Simulation:
    """Return a simulation of a run, recorded into ``path``, in which no process but those ``without`` lacks.

    Whoever leaves ``files`` closes the recording of a run that was not simulated to its end. ``resume`` goes on with
    the one that is there.
    """
    simulation = Simulation(seed, ROUTER, network)
    start = 2 if resume else 1
    file = files.enter_context(RecorderFile(plan, f"recorder-{start}", path, attachments))
    if ROUTER not in without:
        simulation.add(ROUTER, RouterMachine(plan, f"router-{start}"))
    if RECORDER not in without:
        resumes = recorded_boots(path, plan) if resume else None
        recorder = RecorderMachine(
            plan, f"recorder-{start}", ENDPOINT, str(path), patience_ns=patience_ns, exists=resume, resumes=resumes
        )
        simulation.add(RECORDER, recorder, file.perform)
    for name in plan.graph.nodes:
        if name not in without:
            simulation.add(name, host_of(name, plan, f"{name}-{start}", log, patience_ns))
    return simulation
