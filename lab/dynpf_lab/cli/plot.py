"""``dynpf plot``: a figure of a run for a paper, or a film of it."""

import argparse
from pathlib import Path

from dynpf_lab.cli.arguments import add_recording

__all__ = ["add_arguments"]

NAMES = ("overview", "trajectory", "errors", "filters", "health", "particles")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf plot``."""
    add_recording(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="a .png, .svg or .pdf, or the run as it goes, from above: a .gif or .mp4",
    )
    parser.add_argument(
        "--figure", choices=NAMES, metavar="NAME", help=f"which: {', '.join(NAMES)} (default: {NAMES[0]})"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf plot`` and return its exit code."""
    from dynpf_experiments.pictures.whole import whole
    from dynpf_experiments.plots.figures import MOVING, SUFFIXES, save
    from dynpf_formats.recording.reader import read_recording
    from dynpf_protocol.errors import UsageError

    path: Path = options.output
    if path.suffix not in (*SUFFIXES, *MOVING):
        endings = ", ".join((*SUFFIXES, *MOVING))
        raise UsageError(f"-o {path}: ends in {path.suffix or 'nothing'!r}; expected one of {endings}")
    if path.suffix in MOVING and options.figure is not None:
        raise UsageError(f"--figure {options.figure}: a {path.suffix} shows the run from above, and takes no --figure")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"-o {path}: there is no folder {path.absolute().parent}")
    save(whole(read_recording(options.recording, allow_truncated=True)), options.figure or NAMES[0], path)
    print(f"figure: {path}")
    return 0
