"""``dynpf health``: whether a process of a run is alive and its main loop goes round."""

import argparse
import time
from typing import Any

from dynpf_lab.cli.service import DEFAULT_ENDPOINT, endpoint

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("health", help="whether a process of a run is alive and its main loop goes round")
    parser.add_argument("name", metavar="NAME")
    parser.add_argument(
        "--connect", default=DEFAULT_ENDPOINT, type=endpoint, metavar="tcp/HOST:PORT", help="where the router listens"
    )
    parser.add_argument("--timeout", type=float, default=3.0, metavar="S", help="how long to wait for a heartbeat")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
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
