"""``dynpf record``: what is said on keys of Zenoh, into a file that says what is missing."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import DynpfError

from dynpf_lab.cli.arguments import add_json, finite_number
from dynpf_lab.cli.robots import add_robot
from dynpf_lab.cli.run import check_output

if TYPE_CHECKING:
    from dynpf_formats.ros2.types import Releases

__all__ = ["add_arguments"]

EVERYTHING = "**"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf record``."""
    parser.description = (
        "Records what is published on keys of Zenoh into an MCAP file, until Ctrl-C. Topics of ROS 2 (rmw_zenoh) are "
        "written as ROS messages, which Foxglove, rosbags and dynpf import rosbag read; other keys are kept as they "
        "come. What is lost on the way, by the numbers of each publisher, is told at the end and by dynpf doctor."
    )
    parser.add_argument(
        "keys",
        nargs="*",
        metavar="KEY",
        default=[EVERYTHING],
        help=f"a key expression of Zenoh, or a ROS topic such as /scan or '/bot1/**' (default: all, '{EVERYTHING}')",
    )
    add_robot(parser)
    parser.add_argument(
        "--format",
        choices=["rmw_zenoh", "raw"],
        default="rmw_zenoh",
        help="raw: no key is a ROS topic, all are kept as they come (default: %(default)s)",
    )
    parser.add_argument(
        "--duration", type=_duration, metavar="S", help="end so many seconds after the router is there (default: never)"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="F.mcap", help="the file to write")
    add_json(parser, "print at the end what was recorded and lost as one JSON object")
    parser.set_defaults(run=run)


def _duration(text: str) -> float:
    value = finite_number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} s; expected more than 0")
    return value


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf record`` and return its exit code."""
    from dynpf_formats.capture.form import Began
    from dynpf_formats.capture.report import summary, summary_lines
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_services.ros2.hearing import key_expression
    from dynpf_services.ros2.recorder import record

    import dynpf

    keys = [key_expression(text, options.domain) for text in dict.fromkeys(options.keys)]
    releases = _releases() if options.format == "rmw_zenoh" else None
    check_output(options.output)
    began = Began(
        dynpf_version=dynpf.__version__,
        connect=options.connect,
        keys=tuple(map(str, keys)),
        domain=options.domain,
        format=options.format,
        began_ns=time.time_ns(),
    )
    try:
        with StopSignal.installed() as stop:
            tally, ended = record(began, keys, releases, options.output, stop=stop, duration_s=options.duration)
    except DynpfError:
        if options.output.is_file():
            print(f"dynpf record: dynpf recover {options.output} keeps what was recorded so far", file=sys.stderr)
        raise
    told = summary(options.output, began, ended, tally)
    print(json.dumps(told) if options.json else "\n".join(summary_lines(told)))
    never = any(since_ns == began.began_ns for since_ns, _ in ended.outages)
    return 1 if never else 0


def _releases() -> "Releases":
    from dynpf_experiments.extras import needing

    with needing("rosbags", extra="ros", what="recording ROS 2 (without it: --format raw)"):
        from dynpf_formats.ros2.types import Releases
    return Releases()
