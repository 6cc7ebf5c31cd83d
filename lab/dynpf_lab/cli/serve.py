"""``dynpf view --foxglove`` and ``--lichtblick``: a run in a viewer that runs in the browser, afterwards or live."""

import argparse
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING
from urllib.parse import urlencode, urlsplit

from dynpf_protocol.errors import DynpfError

if TYPE_CHECKING:
    from dynpf_experiments.viewers.items import Item

__all__ = ["LAYOUT", "add_viewers", "serve", "viewer_of"]

VIEWERS = {
    "foxglove": "https://app.foxglove.dev/~/view",
    "lichtblick": "https://lichtblick-suite.github.io/lichtblick/",
}
"""Viewers that run in a browser, by the option that names them: where they are to be had without an installation."""

LAYOUT = Path(__file__).parents[1] / "serving" / "layout.json"


def add_viewers(parser: argparse.ArgumentParser) -> None:
    """Add --foxglove and --lichtblick."""
    for option, name in VIEWERS.items():
        parser.add_argument(
            f"--{option}",
            nargs="?",
            const=name,
            metavar="URL",
            type=_page,
            help=f"instead, serve the run and a layout on loopback until Ctrl-C, and print the link by which "
            f"{option.title()} opens it; of a run that goes on name its folder; URL is where {option.title()} runs "
            f"(default: {name})",
        )


def viewer_of(options: argparse.Namespace) -> str | None:
    """Return the address of the viewer that is asked for, or None."""
    found = (getattr(options, option) for option in VIEWERS)
    return next((address for address in found if address is not None), None)


def _page(text: str) -> str:
    """Check the address of a viewer; for argparse."""
    parts = urlsplit(text)
    if parts.scheme not in {"http", "https"} or not parts.netloc:
        raise argparse.ArgumentTypeError(f"{text!r}: expected an address, such as http://localhost:8080")
    return text


def serve(recording: Path, viewer: str, *, open_link: bool) -> int:
    """Serve a recorded run, or by its folder one that goes on, until Ctrl-C; return the exit code."""
    return (_live if recording.is_dir() else _files)(recording, viewer, open_link=open_link)


def _files(path: Path, viewer: str, *, open_link: bool) -> int:
    from dynpf_formats.recording.reader import read_recording

    from dynpf_lab.cli.export_run import export
    from dynpf_lab.serving.files import FileServer

    recording = read_recording(path, allow_truncated=True)
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        run = Path(folder) / "run.mcap"
        export(recording, "foxglove", run)
        parts = urlsplit(viewer)
        files = {"run.mcap": run, "layout.json": LAYOUT}
        with FileServer(files, f"{parts.scheme}://{parts.netloc}") as server:
            layout = server.address("layout.json")
            _tell(viewer, {"ds": "remote-file", "ds.url": server.address("run.mcap")}, layout, open_link=open_link)
            with suppress(KeyboardInterrupt):
                server.serve_forever()
    return 0


def _live(folder: Path, viewer: str, *, open_link: bool) -> int:
    from datetime import UTC, datetime

    from dynpf_experiments.extras import needing
    from dynpf_protocol.keys import OBSERVER
    from dynpf_runtime.bus.keys import load
    from dynpf_runtime.bus.listener import listening
    from dynpf_runtime.bus.run_folder import GUEST_KEYS, read_place
    from dynpf_runtime.bus.terminal import StopSignal, say

    from dynpf_lab.serving.files import FileServer

    place = read_place(folder)
    keys = load(folder / GUEST_KEYS, OBSERVER, datetime.now(UTC)) if place.endpoint.startswith("tls/") else None
    # The listener is forked first, from a process without threads.
    with listening(place.endpoint, keys) as listener, StopSignal.installed() as stop:
        with needing("foxglove", extra="foxglove", what="Foxglove's WebSocket"):
            from dynpf_lab.serving.live import LiveRun
        parts = urlsplit(viewer)
        run = LiveRun()
        with FileServer({"layout.json": LAYOUT}, f"{parts.scheme}://{parts.netloc}") as server:
            Thread(target=server.serve_forever, daemon=True).start()
            query = {"ds": "foxglove-websocket", "ds.url": run.address}
            _tell(viewer, query, server.address("layout.json"), open_link=open_link)
            run.show_always(_map_of(Path(place.recording)))
            over = run.follow(listener, lambda: not stop.requested)
            server.shutdown()
        run.close()
    if over != "stopped":
        say("view", "the run is over" if over == "gone" else f"the run is not followed any more: {over}")
    return 0


def _map_of(recording: Path) -> "list[Item]":
    """Return the map of a run whose recording has begun; nothing where it cannot be read yet."""
    from dynpf_experiments.pictures.source import Budget
    from dynpf_experiments.pictures.whole import whole
    from dynpf_experiments.viewers.items import map_of
    from dynpf_formats.recording.reader import read_recording

    with suppress(DynpfError):
        return list(map_of(whole(read_recording(recording, allow_truncated=True), Budget())))
    return []


def _tell(viewer: str, query: dict[str, str], layout: str, *, open_link: bool) -> None:
    """Print the link by which a viewer opens what is served, and where the layout is; open the link if asked to."""
    link = f"{viewer}{'&' if urlsplit(viewer).query else '?'}{urlencode(query)}"
    print(f"link    {link}\nlayout  {layout} (in its layouts menu: import from file)", flush=True)
    print("dynpf view: serving until Ctrl-C", file=sys.stderr)
    if open_link:
        import webbrowser

        webbrowser.open(link)
