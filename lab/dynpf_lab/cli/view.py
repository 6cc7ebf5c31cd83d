"""``dynpf view``: the page of a recorded run, or of two side by side, in a browser."""

import argparse
import os
import sys
from pathlib import Path

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_connect, add_keys
from dynpf_lab.cli.options import add_allow_code
from dynpf_lab.cli.serve import add_viewers, serve, viewer_of

__all__ = ["add_arguments", "open_browser"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf view``."""
    parser.description = (
        "Makes the page of a recording, unless it is there already, prints its path and opens it in a browser. With "
        "two recordings the page shows both runs, and what sets them apart. A page needs no network and no server. "
        "With --live it serves a page on this machine that follows a run while it goes on."
    )
    parser.add_argument(
        "recording", type=Path, nargs="?", metavar="RUN.mcap", help="with --live: what is being written, or its folder"
    )
    parser.add_argument("other", type=Path, nargs="?", metavar="OTHER.mcap", help="another run, to be compared with")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="PAGE.html", help="the page to write (default: beside the recording)"
    )
    parser.add_argument(
        "--particles",
        choices=["recorded", "all"],
        default="recorded",
        help="recorded: at most 200 of a cloud (default); all: up to 5000, for which filters are executed again",
    )
    add_viewers(parser)
    parser.add_argument("--no-open", action="store_true", help="only make the page and print its path")
    parser.add_argument("--live", action="store_true", help="follow a run that goes on")
    parser.add_argument(
        "--port", type=int, default=0, metavar="PORT", help="with --live: where to serve (default: any)"
    )
    add_connect(parser, text="with --live: where the router listens")
    add_keys(parser)
    add_allow_code(parser, "the run")
    parser.add_argument("--beside-run", action="store_true", help=argparse.SUPPRESS)  # dynpf run --watch has started it
    parser.add_argument(
        "--no-page", action="store_true", help=argparse.SUPPRESS
    )  # which makes no page of the whole run
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf view`` and return its exit code."""
    if options.live:
        from dynpf_lab.cli.live import run_live

        return run_live(options)
    for option, given in (("--connect", options.connect), ("--keys", options.keys), ("--port", options.port)):
        if given:
            raise UsageError(f"{option} {given}: does nothing without --live")
    if options.recording is None:
        raise UsageError("name a recording: dynpf view RUN.mcap")

    from dynpf_formats.recording.reader import read_recording

    if (viewer := viewer_of(options)) is not None:
        if options.other is not None:
            raise UsageError(f"{options.other}: a viewer is given one run")
        return serve(options.recording, viewer, open_link=not options.no_open and _has_screen())
    from dynpf_services.scenario.replay import scenario_of_replay

    from dynpf_lab.page import make_page, page_of

    paths = [path for path in (options.recording, options.other) if path is not None]
    page = options.output or page_of(*paths)
    recordings = [read_recording(path, allow_truncated=True) for path in paths]
    scenarios = [scenario_of_replay(each) for each in recordings] if options.particles == "all" else []
    make_page(recordings, page, scenarios=scenarios)
    print(page)
    if not options.no_open:
        open_browser(page.resolve().as_uri())
    return 0


def open_browser(address: str) -> None:
    """Open an address where a browser has somewhere to open; else Python would take a browser for terminals."""
    if _has_screen():
        import webbrowser

        webbrowser.open(address)


def _has_screen() -> bool:
    return sys.platform in {"darwin", "win32"} or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
