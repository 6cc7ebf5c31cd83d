"""``dynpf import``: foreign logs become recordings."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.importers.log import ImportSummary, Span
    from services.importers.stream import LogStream, StreamSummary

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``import FORMAT SOURCE -o OUT`` to the command line."""
    parser = subparsers.add_parser("import", help="turn a foreign log into a recording")
    formats = parser.add_subparsers(metavar="FORMAT", required=True)

    mrclam = formats.add_parser("mrclam", help="a folder of a UTIAS MRCLAM data set, plain or .xz")
    _add_common(mrclam, "folder with the tables of the data set")
    mrclam.add_argument("--robot", metavar="N", type=int, help="which robot, where there are several")
    mrclam.set_defaults(run=_import_mrclam)

    carmen = formats.add_parser("carmen", help="a CARMEN log, plain, .gz, .xz or .bz2")
    _add_common(carmen, "file with lines such as FLASER, ROBOTLASER1, ODOM")
    carmen.add_argument("--range-max", metavar="M", type=_metres, help="ranges from here on are no return")
    carmen.set_defaults(run=_import_carmen)


def _add_common(parser: argparse.ArgumentParser, source: str) -> None:
    parser.add_argument("source", metavar="SOURCE", type=Path, help=source)
    parser.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="recording to be written")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")


def _metres(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number of metres above 0")
    return value


# What reads and writes logs is loaded on use: dynpf --help shall not wait for it.


def _import_mrclam(args: argparse.Namespace) -> int:
    import msgspec

    from services.importers.mrclam import import_mrclam
    from services.importers.recording import write_recording

    log = import_mrclam(args.source, args.robot)
    write_recording(log, args.output)
    print(msgspec.json.encode(log.summary).decode() if args.json else _mrclam_in_words(log.summary, args.output))
    return 0


def _import_carmen(args: argparse.Namespace) -> int:
    from services.importers.carmen import import_carmen

    return _write(import_carmen(args.source, range_max=args.range_max), args)


def _write(log: "LogStream", args: argparse.Namespace) -> int:
    import msgspec

    from services.importers.recording import write_stream

    summary = write_stream(log, args.output)
    print(msgspec.json.encode(summary).decode() if args.json else _in_words(summary, args.output))
    return 0


def _in_words(summary: "StreamSummary", output: Path) -> str:
    lines = [f"{output}: {summary.source} ({summary.format}), {summary.duration_s:.1f} s"]
    lines += [f"  {topic:<18} {count}" for topic, count in summary.messages.items()]
    lines += [f"  attached           {name}" for name in summary.attachments]
    lines += [f"  {name.replace('_', ' ')}: {value}" for name, value in summary.settings.items()]
    lines += [f"  left out: {lost.count} {why} (first: {lost.first})" for why, lost in summary.dropped.items()]
    return "\n".join(lines)


def _mrclam_in_words(summary: "ImportSummary", output: Path) -> str:
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
