"""The router process: a Zenoh session in router mode that knows the scenario of the run."""

from dynpf_protocol.keys import ROUTER
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.session import open_router
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.router import RouterMachine

__all__ = ["run_router"]


def run_router(scenario: str, endpoint: str, stop: StopSignal, *, quiet: bool) -> None:
    """Route at ``endpoint`` until the run of the resolved ``scenario`` has ended and all processes have left.

    Raises UsageError if it cannot listen there, BrokenOffError if all left before the run was recorded.
    """
    with open_router(endpoint) as bus:
        if not quiet:
            say(ROUTER, f"listening at {endpoint}")
        drive(ROUTER, RouterMachine(scenario, new_boot()), bus, stop)
