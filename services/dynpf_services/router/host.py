"""The router process: a Zenoh session in router mode that knows the scenario of the run."""

from dynpf_protocol.keys import ROUTER
from dynpf_runtime.bus.access import PLAYER, access_control, grants
from dynpf_runtime.bus.edge import drive, new_boot
from dynpf_runtime.bus.keys import Credentials, current_name, revoked
from dynpf_runtime.bus.pulse import Pulse
from dynpf_runtime.bus.refused import Refused, tell_tls_refusals
from dynpf_runtime.bus.session import open_router
from dynpf_runtime.bus.terminal import StopSignal, say
from dynpf_runtime.machines.router import RouterMachine
from dynpf_runtime.plan import Plan

__all__ = ["run_router"]


def run_router(
    plan: Plan,
    endpoint: str,
    stop: StopSignal,
    *,
    pulse: Pulse,
    quiet: bool,
    keys: Credentials | None = None,
    player: bool = False,
) -> None:
    """Route at ``endpoint`` until the run of ``plan`` has ended and all processes have left.

    With ``keys`` each process may say and hear what the plan has it say and hear; a ``player`` may say everything.
    Raises UsageError if it cannot listen there, BrokenOffError if all left before the run was recorded.
    """
    refused = Refused(lambda text: say(ROUTER, text))
    access, known = None, set[str]()
    if keys is not None:
        withdrawn = revoked(keys.folder)
        granted = grants(plan.graph)
        names = {name: current_name(name, withdrawn) for name in granted if player or name != PLAYER}
        access, known = access_control(granted, names), {*names.values()}
        if withdrawn and not quiet:
            say(ROUTER, f"revoked certificates get no access: {', '.join(withdrawn)}")
        tell_tls_refusals(refused)
    with open_router(endpoint, keys, access) as bus:
        if not quiet:
            say(ROUTER, f"listening at {endpoint}")
        if keys is not None:
            bus.watch_links(refused.watch_names(known))
        drive(ROUTER, RouterMachine(plan, new_boot()), bus, stop, pulse=pulse)
