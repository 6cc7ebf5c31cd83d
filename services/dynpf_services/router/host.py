"""The router process: a Zenoh session in router mode that knows the scenario of the run."""

from dynpf_protocol.keys import ROUTER
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.session import open_router
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.plan import Plan

__all__ = ["run_router"]


def run_router(plan: Plan, endpoint: str, stop: StopSignal, *, quiet: bool) -> None:
    """Route at ``endpoint`` until the run of ``plan`` has ended and all processes have left.

    Raises UsageError if it cannot listen there, BrokenOffError if all left before the run was recorded.
    """
    with open_router(endpoint) as bus:
        if not quiet:
            say(ROUTER, f"listening at {endpoint}")
        drive(ROUTER, RouterMachine(plan, new_boot()), bus, stop)
