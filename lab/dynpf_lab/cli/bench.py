"""``dynpf bench``: what updates cost, against plain NumPy and other libraries."""

import argparse
import difflib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

if TYPE_CHECKING:
    from dynpf.maps.occupancy import OccupancyGrid

__all__ = ["add_parser"]

COUNTS = (1_000, 10_000, 100_000, 1_000_000)
# An image alone says nothing of its scale.
IMAGE_AS_MAP = "image: {}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("bench", help="what updates cost, against plain NumPy and other libraries")
    parser.add_argument("--work", metavar="NAME", action="append", help="measure this only; may be said again")
    parser.add_argument("--map", metavar="FILE", type=Path, help="map_server YAML, or an image with cells of 5 cm")
    parser.add_argument("--n", metavar="N,...", type=_counts, default=COUNTS, help="numbers of particles")
    parser.add_argument(
        "--beams", metavar="N", type=_positive, help="beams a scan, instead of what the work is named by"
    )
    parser.add_argument("--threads", metavar="N", type=_positive, default=1, help="run ours with so many threads too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def _positive(word: str) -> int:
    number = int(float(word)) if word.replace("e", "", 1).isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{word!r} is not a whole number above zero")
    return number


def _counts(words: str) -> tuple[int, ...]:
    return tuple(sorted({_positive(word) for word in words.split(",")}))


def run(options: argparse.Namespace) -> int:
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
            rows = list(measure(plan, grid, peers.all, _show))
        finally:
            _show("")
    print(json.dumps({"study": "bench", "rows": rows}) if options.json else text(rows))
    return 0


def _grid(path: Path | None) -> "OccupancyGrid":
    """Return the map of a file, or the floor plan that is generated where none is named."""
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
    except ValueError as error:  # of the map, or of text that is none
        raise UsageError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    if not grid.occupied.any() or not grid.free.any():
        raise UsageError(f"{path}: a map with both walls and free cells is needed")
    return grid


def _show(text: str) -> None:
    """Tell a person who watches what is being done."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
