"""Runs as processes on the bus: the options that they share, and how they are started from the command line."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_lab.cli.arguments import add_durable

if TYPE_CHECKING:
    from dynpf_runtime.bus.processes import Companion
    from dynpf_runtime.plan import Plan
    from dynpf_services.scenario.played_log import PlayedLog
    from dynpf_services.scenario.schema import Scenario

__all__ = ["add_restarts", "add_runner", "run_processes"]

RESTARTS = 3


def add_runner(parser: argparse.ArgumentParser) -> None:
    """Add --runner, --keys, --insecure, --durable and --restarts."""
    parser.add_argument("--runner", choices=["bus", "inline"], default="bus", help="processes on Zenoh, or one process")
    parser.add_argument(
        "--keys",
        type=Path,
        metavar="FOLDER",
        help="where the keys of an observer and an operator lie during the run (default: the run's own folder)",
    )
    parser.add_argument(
        "--insecure", action="store_true", help="plain tcp: any program on this machine may speak and listen"
    )
    add_durable(parser)
    add_restarts(parser)


def add_restarts(parser: argparse.ArgumentParser) -> None:
    """Add --restarts."""
    parser.add_argument(
        "--restarts",
        type=_number,
        default=RESTARTS,
        metavar="N",
        help="how often each process is started again that was killed or hangs (default: %(default)s)",
    )


def _number(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text}: expected 0 or more")
    return int(text)


def run_processes(
    scenario: "Scenario",
    plan: "Plan",
    path: Path,
    log: "PlayedLog | None",
    code: Sequence[Path],
    *,
    companion: "Companion | None" = None,
    **how: Any,
) -> None:
    """Run a scenario as processes into a recording; a signal ends it as a whole one. ``how`` is for ``run_on_bus``."""
    from dynpf_runtime.bus.processes import run_on_bus
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_runtime.rehearsal import rehearse_run
    from dynpf_services.scenario.schema import whole_json

    from dynpf_lab.cli.main import main

    # Kernels are compiled once here instead of in every process at the same time.
    rehearse_run(plan, log.records if log else [])
    with StopSignal.installed() as stop:
        run_on_bus(
            main,
            plan.graph.nodes,
            whole_json(scenario),
            path,
            stop=stop,
            log=log.path if log else None,
            code=code,
            companion=companion,
            **how,
        )
        if companion is not None:
            companion.hurries = stop.requested
