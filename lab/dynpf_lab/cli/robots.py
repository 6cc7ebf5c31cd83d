"""Options of the commands that join a live robot."""

import argparse
import re

from dynpf_lab.cli.arguments import finite_number

__all__ = ["add_robot", "seconds"]

_LONGEST_S = 3600.0


def add_robot(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add --connect and --domain."""
    parser.add_argument(
        "--connect", type=_endpoint, required=required, metavar="tcp/ROBOT:7447", help="the robot's Zenoh router"
    )
    parser.add_argument("--domain", type=_domain, default=0, metavar="N", help="ROS_DOMAIN_ID (default 0)")


def _domain(text: str) -> int:
    if not text.isdecimal() or not 0 <= int(text) <= 232:
        raise argparse.ArgumentTypeError(f"{text}: expected 0 to 232")
    return int(text)


def _endpoint(text: str) -> str:
    if re.fullmatch(r"[a-z]+/[^/\s]+:\d{1,5}", text) is None:
        raise argparse.ArgumentTypeError(f"{text}: expected tcp/ROBOT:7447")
    return text


def seconds(text: str) -> float:
    """Read how long something may take; for argparse."""
    value = finite_number(text)
    if not 0 < value <= _LONGEST_S:
        raise argparse.ArgumentTypeError(f"{text} s; expected up to {_LONGEST_S:g}")
    return value
