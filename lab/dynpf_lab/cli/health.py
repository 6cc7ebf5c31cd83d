"""``dynpf health``: whether a process of a run is alive and its main loop runs."""

import argparse
import time

from dynpf_lab.cli.arguments import add_connect

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf health``."""
    parser.add_argument("name", metavar="NAME")
    add_connect(parser)
    parser.add_argument("--timeout", type=float, default=3.0, metavar="S", help="how long to wait for a heartbeat")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf health`` and return its exit code."""
    from dynpf_protocol.errors import RunError
    from dynpf_protocol.keys import ALIVE, BEAT
    from dynpf_runtime.bus.session import Bus

    deadline = time.monotonic() + options.timeout
    try:
        with Bus.connect(options.connect, lambda _: None, lambda: time.monotonic() > deadline) as bus:
            bus.subscribe(f"{BEAT}{options.name}")
            if not bus.tokens(f"{ALIVE}{options.name}/*"):
                raise RunError(f"{options.name} is not there (no liveliness token at {options.connect})")
            if bus.receive(max(deadline - time.monotonic(), 0.0)) is None:
                raise RunError(f"{options.name} is there but has not beaten for {options.timeout:g} s: it hangs")
    except KeyboardInterrupt:
        raise RunError(f"no router at {options.connect} within {options.timeout:g} s") from None
    print(f"{options.name}: healthy")
    return 0
