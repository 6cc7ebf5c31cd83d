"""``dynpf view``: the page of a recorded run, or of two side by side, in a browser."""

import argparse
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlencode, urlsplit

from dynpf_lab.cli.arguments import add_recording

__all__ = ["add_arguments"]

VIEWERS = {
    "foxglove": "https://app.foxglove.dev/~/view",
    "lichtblick": "https://lichtblick-suite.github.io/lichtblick/",
}
"""Viewers that run in a browser, by the option that names them: where they are to be had without an installation."""

LAYOUT = Path(__file__).parents[1] / "serving" / "layout.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf view``."""
    parser.description = (
        "Makes the page of a recording, unless it is there already, prints its path and opens it in a browser. With "
        "two recordings the page shows both runs, and what sets them apart. A page needs no network and no server."
    )
    add_recording(parser)
    parser.add_argument("other", type=Path, nargs="?", metavar="OTHER.mcap", help="another run, to be compared with")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="PAGE.html", help="the page to write (default: beside the recording)"
    )
    for option, name in VIEWERS.items():
        parser.add_argument(
            f"--{option}",
            nargs="?",
            const=name,
            metavar="URL",
            type=_page,
            help=f"instead, serve the run and a layout on loopback until Ctrl-C, and print the link by which "
            f"{option.title()} opens it; URL is where that runs (default: {name})",
        )
    parser.add_argument("--no-open", action="store_true", help="only make the page and print its path")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf view`` and return its exit code."""
    from dynpf_formats.recording.reader import read_recording

    for option in VIEWERS:
        if (viewer := getattr(options, option)) is not None:
            return _serve(options, viewer)
    from dynpf_lab.page import make_page, page_of

    paths = [path for path in (options.recording, options.other) if path is not None]
    page = options.output or page_of(*paths)
    recordings = [read_recording(path, allow_truncated=True) for path in paths]
    make_page(recordings, page)
    print(page)
    if not options.no_open and _has_screen():
        import webbrowser

        webbrowser.open(page.resolve().as_uri())
    return 0


def _page(text: str) -> str:
    """Check the address of a viewer; for argparse."""
    parts = urlsplit(text)
    if parts.scheme not in {"http", "https"} or not parts.netloc:
        raise argparse.ArgumentTypeError(f"{text!r}: expected an address, such as http://localhost:8080")
    return text


def _serve(options: argparse.Namespace, viewer: str) -> int:
    """Serve a run as a viewer reads it, until Ctrl-C; return the exit code."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_protocol.errors import UsageError

    from dynpf_lab.cli.export_run import export
    from dynpf_lab.serving.files import FileServer

    if options.other is not None:
        raise UsageError(f"{options.other}: a viewer is given one run")
    recording = read_recording(options.recording, allow_truncated=True)
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        run = Path(folder) / "run.mcap"
        export(recording, "foxglove", run)
        files = {"run.mcap": run, "layout.json": LAYOUT}
        parts = urlsplit(viewer)
        with FileServer(files, f"{parts.scheme}://{parts.netloc}") as server:
            query = urlencode({"ds": "remote-file", "ds.url": server.address("run.mcap")})
            link = f"{viewer}{'&' if parts.query else '?'}{query}"
            print(f"link    {link}\nlayout  {server.address('layout.json')} (its menu: import from file)", flush=True)
            print("dynpf view: serving until Ctrl-C", file=sys.stderr)
            if not options.no_open and _has_screen():
                import webbrowser

                webbrowser.open(link)
            with suppress(KeyboardInterrupt):
                server.serve_forever()
    return 0


def _has_screen() -> bool:
    """Return whether a browser has somewhere to open; without one Python would take a browser for terminals."""
    return sys.platform in {"darwin", "win32"} or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
