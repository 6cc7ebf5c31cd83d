"""``dynpf import``: foreign logs become recordings."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.importers.log import ImportSummary, Span

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``import FORMAT SOURCE -o OUT`` to the command line."""
    parser = subparsers.add_parser("import", help="turn a foreign log into a recording")
    formats = parser.add_subparsers(metavar="FORMAT", required=True)
    mrclam = formats.add_parser("mrclam", help="a folder of a UTIAS MRCLAM data set, plain or .xz")
    mrclam.add_argument("source", metavar="SOURCE", type=Path, help="folder with the tables of the data set")
    mrclam.add_argument("--robot", metavar="N", type=int, help="which robot, where there are several")
    mrclam.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="recording to be written")
    mrclam.add_argument("--json", action="store_true", help="print the summary as one JSON document")
    mrclam.set_defaults(run=_import_mrclam)


def _import_mrclam(args: argparse.Namespace) -> int:
    # What reads and writes logs is loaded on use: dynpf --help shall not wait for it.
    import msgspec

    from services.importers.mrclam import import_mrclam
    from services.importers.recording import write_recording

    log = import_mrclam(args.source, args.robot)
    write_recording(log, args.output)
    print(msgspec.json.encode(log.summary).decode() if args.json else _in_words(log.summary, args.output))
    return 0


def _in_words(summary: "ImportSummary", output: Path) -> str:
    robot = "" if summary.robot is None else f", robot {summary.robot}"
    dropped = (
        f"{summary.dropped_robots} of other robots, {summary.dropped_unknown_barcodes} of unknown barcodes,"
        f" {summary.dropped_unmapped} of landmarks without a position"
    )
    lines = [
        f"{output}: {summary.source}{robot}, {summary.duration_s:.1f} s",
        f"  odometry          {summary.odometry}",
        f"  landmark readings {summary.landmark_readings} in {summary.landmark_messages} messages",
        f"  reference poses   {summary.references}",
        f"  landmarks         {summary.landmarks}",
        f"  readings dropped  {dropped}",
        f"  reference gaps    {_spans(summary.reference_gaps)}",
        f"  heading at fault  {_spans(summary.heading_faults)}",
    ]
    return "\n".join(lines)


def _spans(spans: "tuple[Span, ...]") -> str:
    return ", ".join(f"{first:.1f}..{last:.1f} s" for first, last in spans) or "none"
