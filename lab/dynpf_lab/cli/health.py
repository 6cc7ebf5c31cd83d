"""``dynpf health``: whether a process of a run is alive and its main loop runs."""

import argparse
import time

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.arguments import add_connect, add_keys

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf health``."""
    parser.add_argument("name", metavar="NAME", help="router, recorder, or a node of the scenario")
    add_connect(parser)
    add_keys(parser)
    parser.add_argument("--timeout", type=float, default=3.0, metavar="S", help="how long to wait for a heartbeat")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf health`` and return its exit code."""
    from dynpf_protocol.errors import RunError
    from dynpf_protocol.keys import ALIVE, BEAT, OBSERVER
    from dynpf_runtime.bus.session import Bus

    endpoint = endpoint_of(options)
    own = options.keys is not None and (options.keys / f"{options.name.replace('/', '.')}.pem").exists()
    keys = credentials_of(options, options.name if own else OBSERVER, quiet=True)
    deadline = time.monotonic() + options.timeout
    hint = f" that {keys.certificate} may see" if keys else ""
    try:
        with Bus.connect(endpoint, lambda _: None, lambda: time.monotonic() > deadline, keys) as bus:
            bus.subscribe(f"{BEAT}{options.name}")
            while not bus.tokens(f"{ALIVE}{options.name}/*"):
                if time.monotonic() > deadline:
                    raise RunError(
                        f"{options.name} is not there (nobody of that name has joined the run at {endpoint}{hint})"
                    )
                bus.receive(0.1)  # it may be starting
            if bus.receive(max(deadline - time.monotonic(), 0.0)) is None:
                raise RunError(f"{options.name} is there but has not beaten for {options.timeout:g} s: it hangs")
    except KeyboardInterrupt:
        raise RunError(f"no router at {endpoint} within {options.timeout:g} s") from None
    print(f"{options.name}: healthy")
    return 0
