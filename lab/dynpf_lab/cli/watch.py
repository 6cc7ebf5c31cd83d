"""``--watch``: a page that shows a run while it goes on, served beside the run's processes."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import SPEED, speed

if TYPE_CHECKING:
    from dynpf_runtime.bus.processes import Companion

__all__ = ["add_watch", "begins_at", "check_watch", "seen_off", "watcher"]

LAST_S = 2.0
"""How long browsers may take to be told that the run has failed, or was stopped."""


def add_watch(parser: argparse.ArgumentParser) -> None:
    """Add --watch, --watch-port and --speed."""
    parser.add_argument(
        "--watch", action="store_true", help="print the address of a page that shows the run while it goes on"
    )
    parser.add_argument(
        "--watch-port", type=int, default=0, metavar="PORT", help="where that page is served (default: any free port)"
    )
    parser.add_argument(
        "--speed",
        type=speed,
        metavar="X",
        help=f"{SPEED} (default: the scenario's rate; with --watch 1 if it has none)",
    )


def check_watch(options: argparse.Namespace) -> None:
    """Raise UsageError for options that do nothing here."""
    for option, given in (("--watch", options.watch), ("--speed", options.speed is not None)):
        if given and options.runner == "inline":
            raise UsageError(f"{option}: a run in one process cannot be watched or paced; it needs --runner bus")
    if options.watch_port and not options.watch:
        raise UsageError(f"--watch-port {options.watch_port}: does nothing without --watch")


def begins_at(options: argparse.Namespace, rate: float | None) -> float | None:
    """Return the speed at which a run begins, None for that of its scenario, whose ``rate`` is given."""
    given: float | None = options.speed
    return 1.0 if given is None and options.watch and rate is None else given


def watcher(options: argparse.Namespace) -> "Companion | None":
    """Return the process that serves the page, None if nobody wants to watch."""
    if not options.watch:
        return None
    from dynpf_runtime.bus.processes import Companion

    from dynpf_lab.cli.main import main

    def words(folder: Path, endpoint: str, guests: Path | None) -> list[str]:
        keys = ["--insecure"] if guests is None else ["--keys", str(guests)]
        page = ["--no-page"] if options.no_page else []
        port = ["--port", str(options.watch_port)] if options.watch_port else []
        return ["view", "--live", str(folder), "--connect", endpoint, *keys, *port, "--beside-run", *page]

    return Companion(main, words)


@contextmanager
def seen_off(companion: "Companion | None") -> Iterator["Companion | None"]:
    """Wait, after a run that has ended well, for browsers to leave its page; a person may end that."""
    patience_s: float | None = LAST_S
    try:
        yield companion
        patience_s = None
    finally:
        if companion is not None:
            companion.see_off(LAST_S if companion.hurries else patience_s)
