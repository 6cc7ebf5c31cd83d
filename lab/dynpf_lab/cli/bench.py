"""``dynpf bench``: times of updates, against plain NumPy and other libraries."""

import argparse
import difflib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json

if TYPE_CHECKING:
    from dynpf.maps.occupancy import OccupancyGrid

__all__ = ["add_arguments"]

COUNTS = (1_000, 10_000, 100_000, 1_000_000)
# An image alone has no scale.
IMAGE_AS_MAP = "image: {}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf bench``."""
    parser.add_argument("--work", metavar="NAME", action="append", help="measure only this work; may be repeated")
    parser.add_argument("--map", metavar="FILE", type=Path, help="map_server YAML, or an image with cells of 5 cm")
    parser.add_argument("--n", metavar="N,...", type=_counts, default=COUNTS, help="numbers of particles")
    parser.add_argument(
        "--beams", metavar="N", type=_positive, help="beams of a scan, instead of the number in the work's name"
    )
    parser.add_argument(
        "--threads", metavar="N", type=_positive, default=1, help="also run ours with this number of threads"
    )
    add_json(parser)
    parser.set_defaults(run=run)


def _positive(word: str) -> int:
    number = int(float(word)) if word.replace("e", "", 1).isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number above zero")
    return number


def _counts(words: str) -> tuple[int, ...]:
    return tuple(sorted({_positive(word) for word in words.split(",")}))


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf bench`` and return its exit code."""
    from dynpf_runtime.progress import show_progress

    from dynpf_lab.bench.measure import Plan, measure
    from dynpf_lab.bench.peers import Peers
    from dynpf_lab.bench.report import text
    from dynpf_lab.bench.works import BEAMS, WORKS

    works = tuple(dict.fromkeys(options.work or WORKS))
    for name in works:
        if name not in WORKS:
            close = difflib.get_close_matches(name, WORKS, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise UsageError(f"unknown work {name!r}; {hint}known are {', '.join(WORKS)}")
    if options.beams is not None and not any(name in BEAMS for name in works):
        raise UsageError(f"--beams {options.beams}: no work with scans is measured")
    plan = Plan(works, options.n, options.beams, options.threads)
    grid = _grid(options.map)
    wanted = "landmarks_15" in works
    with Peers() if wanted else Peers(()) as peers:
        if wanted and not peers.all:
            print("dynpf bench: without other libraries; `make peers` in a checkout installs them", file=sys.stderr)
        try:
            rows = list(measure(plan, grid, peers.all, show_progress))
        finally:
            show_progress("")
    print(json.dumps({"study": "bench", "rows": rows}) if options.json else text(rows))
    return 0


def _grid(path: Path | None) -> "OccupancyGrid":
    """Return the map of a file, or without a file the generated floor plan."""
    from dynpf.maps.map_server import decode
    from dynpf_lab.bench.floor_plan import floor_plan

    if path is None:
        return floor_plan()
    try:
        described = path.suffix.lower() in {".yaml", ".yml"}
        words = path.read_text(encoding="utf-8") if described else IMAGE_AS_MAP.format(json.dumps(path.name))
        grid = decode(words, lambda name: (path.parent / name).read_bytes(), str(path))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # of the map, or of text that is not a map
        raise UsageError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    if not grid.occupied.any() or not grid.free.any():
        raise UsageError(f"{path}: a map with both walls and free cells is needed")
    return grid
