"""The process of one node on the bus."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import cv2

from dynpf.portable import rehearse
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.keys import Credentials
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.session import Bus
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.node_host import NodeHost
from dynpf_runtime.node import Rehearsing
from dynpf_runtime.plan import Plan
from dynpf_runtime.rehearsal import rehearse_run
from dynpf_runtime.source import LiveSource, LogRecord

__all__ = ["run_node"]


def run_node(
    name: str,
    plan: Plan,
    endpoint: str,
    log: Sequence[LogRecord],
    stop: StopSignal,
    *,
    pulse: Pulse,
    keys: Credentials | None = None,
    patience_s: float = 0.0,
    live: Callable[[Bus], AbstractContextManager[LiveSource]] | None = None,
) -> None:
    """Run the node ``name`` of ``plan`` on the bus, from joining to the recorder's confirmation of the run.

    In lockstep processes that are gone are waited for ``patience_s``. ``live`` opens the robot whose records the source
    takes in realtime instead of those of ``log``; it wakes the bus when something has arrived.

    Raises RunError if the run cannot continue, UsageError if this process does not fit into it.
    """
    cv2.setNumThreads(1)  # one order of evaluation, and no contention on few cores
    rehearse_run(plan, log)
    node = plan.graph.specs[name].build()
    if plan.clock == "realtime":
        rehearse()  # in lockstep a slow first step does no harm
    if isinstance(node, Rehearsing):
        node.rehearse()  # takes as long as it needs: the run waits for processes that have not joined
    with (
        Bus.connect(endpoint, lambda text: say(name, text), lambda: stop.requested, keys) as bus,
        nullcontext() if live is None else live(bus) as robot,
    ):
        host = NodeHost(
            name,
            node,
            plan,
            new_boot(),
            endpoint=endpoint,
            log=log,
            gauges=_Gauges(bus, pulse),
            patience_ns=round(patience_s * 1e9),
            live=robot,
        )
        drive(name, host, bus, stop, pulse=pulse)


class _Gauges:
    def __init__(self, bus: Bus, pulse: Pulse) -> None:
        self._bus = bus
        self._pulse = pulse

    def stepping(self, tick: int) -> None:
        """Note that a step of the node begins, which may take long."""
        self._pulse.step(tick)

    def stopwatch_s(self) -> float:
        """Return the seconds of a monotonic clock."""
        return time.perf_counter()

    def waiting(self) -> int:
        """Return the number of arrivals in the queue."""
        return self._bus.waiting
