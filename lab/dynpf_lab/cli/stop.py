"""``dynpf stop``: ask a run to end with its next tick, as its operator."""

import argparse
import time
from contextlib import suppress

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.arguments import add_connect, add_keys

__all__ = ["add_arguments"]

AGAIN_S = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf stop``."""
    add_connect(parser)
    add_keys(parser)
    parser.add_argument("--reason", default="stopped by the operator", help="the recording says it")
    parser.add_argument("--timeout", type=float, default=30.0, metavar="S", help="how long the run may take to end")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf stop`` and return its exit code."""
    from dynpf_protocol.control import Recorded, Stop, decode_control, encode_control
    from dynpf_protocol.errors import ProtocolError, RunError
    from dynpf_protocol.keys import ALIVE, OPERATOR, RECORDED, STOP
    from dynpf_runtime.bus.edge import new_boot
    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.bus.terminal import say
    from dynpf_runtime.machines.events import Arrived

    endpoint, keys = endpoint_of(options), credentials_of(options, OPERATOR, quiet=True)
    deadline = time.monotonic() + options.timeout
    boot = new_boot()
    request = encode_control(Stop(OPERATOR, boot, options.reason))
    try:
        with Bus.connect(endpoint, lambda text: say("stop", text), lambda: time.monotonic() > deadline, keys) as bus:
            bus.subscribe(RECORDED)
            bus.declare(f"{ALIVE}{OPERATOR}/{boot}")
            while time.monotonic() < deadline:
                arrived = bus.receive(AGAIN_S)  # by then the others have seen who asks
                if isinstance(arrived, Arrived):
                    with suppress(ProtocolError):  # without keys it may be anybody's
                        complete = decode_control(arrived.payload, Recorded).complete
                        print(f"the run has ended, and its recording is {'complete' if complete else 'incomplete'}")
                        return 0 if complete else 1
                bus.put(f"{STOP}{OPERATOR}", request)
    except KeyboardInterrupt:
        raise RunError(f"no router at {endpoint} within {options.timeout:g} s") from None
    raise RunError(f"the run at {endpoint} has not ended within {options.timeout:g} s")
