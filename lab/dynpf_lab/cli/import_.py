"""``dynpf import``: make recordings from logs of other formats."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json, finite_number

if TYPE_CHECKING:
    from dynpf_formats.importers.log import ImportedLog, ImportSummary
    from dynpf_formats.recording.header import Attachment

__all__ = ["add_arguments"]

ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf import``."""
    formats = parser.add_subparsers(metavar="FORMAT", required=True)

    mrclam = formats.add_parser("mrclam", help="a folder of a UTIAS MRCLAM data set, plain or .xz")
    _add_common(mrclam, "folder with the tables of the data set")
    mrclam.add_argument("--robot", metavar="N", type=_robot, help="which robot, where there are several; or all")
    mrclam.add_argument(
        "--robots", action="store_true", help="take the other robots as moving landmarks at their reference positions"
    )
    mrclam.set_defaults(run=_import_mrclam)

    carmen = formats.add_parser("carmen", help="a CARMEN log, plain, .gz, .xz or .bz2")
    _add_common(carmen, "file with lines such as FLASER, ROBOTLASER1, ODOM")
    carmen.add_argument("--range-max", metavar="M", type=_metres, help="ranges from here on count as no return")
    _add_map(carmen)
    carmen.add_argument(
        "--map-from-poses", metavar="M", type=_metres, help="draw the map from scans and corrected poses, in cells of M"
    )
    carmen.set_defaults(run=_import_carmen)

    _add_rosbag(formats.add_parser("rosbag", help="a ROS 1 bag, or a ROS 2 bag in sqlite3 or MCAP"))

    world = formats.add_parser("map", help="a map of map_server, as the attachment of a recording without messages")
    _add_common(world, "YAML file; its image beside it")
    world.set_defaults(run=_import_map)

    amcl = formats.add_parser("amcl", help="AMCL's parameters, of ROS 1 or Nav2, as a scenario for laser logs")
    amcl.add_argument("source", metavar="PARAMS.yaml", type=Path, help="nav2_params.yaml, or the parameters of amcl")
    amcl.add_argument("-o", "--output", metavar="MINE.toml", type=Path, required=True, help="scenario to be written")
    add_json(amcl, "print what becomes of each parameter as one JSON document")
    amcl.set_defaults(run=_import_amcl)

    tum = formats.add_parser("tum", help="reference poses as lines of time, position and quaternion")
    _add_common(tum, "text file, plain, .gz, .xz or .bz2")
    tum.add_argument(
        "--log", metavar="LOG.mcap", type=Path, help="an imported log, which takes the poses as its reference"
    )
    tum.set_defaults(run=_import_tum)


def _add_rosbag(parser: argparse.ArgumentParser) -> None:
    _add_common(parser, ".bag, .mcap or .db3 file, or the folder of a ROS 2 bag")
    parser.add_argument(
        "--scan", metavar="TOPIC", help="LaserScan or PointCloud2; else the scanner with the widest view"
    )
    parser.add_argument("--odometry", metavar="TOPIC", help="Odometry, or the word tf; else the first by name, or tf")
    parser.add_argument(
        "--truth", metavar="TOPIC", help="reference poses; else the first whose name contains a word for truth"
    )
    parser.add_argument("--base", metavar="FRAME", help="the robot's frame; else base_footprint, base_link, ...")
    parser.add_argument("--odom-frame", metavar="FRAME", help="odometry's frame in tf (odom, in the scan's namespace)")
    pose = ("X", "Y", "THETA")
    parser.add_argument(
        "--truth-offset",
        metavar=pose,
        nargs=3,
        type=finite_number,
        default=(0.0, 0.0, 0.0),
        help="pose of the map in the truth's frame (m, m, rad)",
    )
    parser.add_argument(
        "--truth-shift", metavar="S", type=finite_number, default=0.0, help="s, added to the truth's stamps"
    )
    band = ("LOW", "HIGH")
    parser.add_argument(
        "--heights",
        metavar=band,
        nargs=2,
        type=finite_number,
        help="the points of a cloud between these heights make the scan (m)",
    )
    _add_map(parser)
    parser.set_defaults(run=_import_rosbag)


def _add_common(parser: argparse.ArgumentParser, source: str) -> None:
    parser.add_argument("source", metavar="SOURCE", type=Path, help=source)
    parser.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="recording to be written")
    add_json(parser, "print the summary as one JSON document")


def _add_map(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--map", metavar="YAML", type=Path, help="a map of map_server to be attached")


def _metres(text: str) -> float:
    value = finite_number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not a number of metres above 0")
    return value


# Importers are loaded at their use, so that dynpf --help starts quickly.


def _robot(text: str) -> int | str:
    if text != ALL and not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r}: expected the number of a robot, or {ALL}")
    return text if text == ALL else int(text)


def _import_mrclam(options: argparse.Namespace) -> int:
    from dynpf_formats.importers.mrclam import import_mrclam, import_mrclam_team

    if options.robot != ALL:
        return _write(import_mrclam(options.source, options.robot, robots=options.robots), options)
    if options.robots:
        raise UsageError("--robots: goes with one robot's log, not with --robot all")
    return _write(import_mrclam_team(options.source), options)


def _import_carmen(options: argparse.Namespace) -> int:
    from dynpf_formats.importers.carmen import import_carmen

    attachments = _map(options)
    if options.map_from_poses is not None:
        from dynpf_formats.importers.mapping import drawn_map

        if options.map is not None:
            raise UsageError("--map and --map-from-poses: one map for a log")
        attachments = drawn_map(
            lambda: import_carmen(options.source, range_max=options.range_max).records, options.map_from_poses, "map"
        )
    return _write(import_carmen(options.source, range_max=options.range_max, attachments=attachments), options)


def _import_rosbag(options: argparse.Namespace) -> int:
    from dynpf_experiments.extras import needing
    from dynpf_formats.importers.clouds import FlattenParams

    with needing("rosbags", extra="ros", what="reading ROS bags"):
        from dynpf_formats.importers.rosbag import BagChoice, import_rosbag
    low, high = options.heights or (FlattenParams().low, FlattenParams().high)
    choice = BagChoice(
        scan=options.scan,
        odometry=options.odometry,
        truth=options.truth,
        base=options.base,
        odom_frame=options.odom_frame,
        truth_offset=tuple(options.truth_offset),
        truth_shift=options.truth_shift,
        flatten=FlattenParams(low=low, high=high),
    )
    return _write(import_rosbag(options.source, choice, attachments=_map(options)), options)


def _import_map(options: argparse.Namespace) -> int:
    from dynpf_formats.importers.maps import import_map

    return _write(import_map(options.source), options)


def _import_amcl(options: argparse.Namespace) -> int:
    from dynpf_lab.cli.import_amcl import import_amcl

    return import_amcl(options)


def _import_tum(options: argparse.Namespace) -> int:
    from dynpf_formats.importers.tum import import_tum

    return _write(import_tum(options.source, options.log), options)


def _map(options: argparse.Namespace) -> "tuple[Attachment, ...]":
    from dynpf_formats.importers.maps import map_attachments

    return () if options.map is None else map_attachments(options.map)


def _write(log: "ImportedLog", options: argparse.Namespace) -> int:
    import msgspec
    from dynpf_formats.importers.recording import write_recording

    summary = write_recording(log, options.output)
    print(json.dumps(msgspec.to_builtins(summary)) if options.json else _in_words(summary, options.output))
    return 0


def _in_words(summary: "ImportSummary", output: Path) -> str:
    lines = [f"{output}: {summary.source} ({summary.format}), {summary.duration_s:.1f} s"]
    lines += [f"  {topic:<18} {count}" for topic, count in summary.messages.items()]
    lines += [f"  attached           {name}" for name in summary.attachments]
    lines += [f"  {name.replace('_', ' ')}: {_in_text(value)}" for name, value in summary.settings.items()]
    lines += [f"  left out: {lost.count} {why} (first: {lost.first})" for why, lost in summary.dropped.items()]
    lines += [f"  warning: {text}" for text in summary.warnings]
    return "\n".join(lines)


def _in_text(value: Any) -> str:
    """Return a setting as text: of spans of time, each in seconds, of a table each entry."""
    match value:
        case dict():
            return ", ".join(f"{name} ({_in_text(inner)})" for name, inner in value.items()) or "none"
        case list() if all(isinstance(item, tuple) for item in value):
            return ", ".join(f"{first:.1f}..{last:.1f}" for first, last in value) or "none"
        case list() | tuple():
            return ", ".join(map(_in_text, value)) or "none"
        case float():
            return f"{value:.6g}"
        case None:
            return "none"
    return str(value)
