"""Arguments that several commands share, without any import that would delay a command's start."""

import argparse
import math
import re
from pathlib import Path

__all__ = [
    "DEFAULT_PORT",
    "SPEED",
    "add_clock",
    "add_connect",
    "add_durable",
    "add_json",
    "add_keys",
    "add_log",
    "add_recording",
    "add_set",
    "endpoint",
    "finite_number",
    "positive_count",
    "speed",
]

DEFAULT_PORT = 7447


SPEED = "seconds of the run in a second, 0: as fast as it goes"


def add_recording(
    parser: argparse.ArgumentParser, *, optional: bool = False, text: str = "the recording of a run"
) -> None:
    """Add RUN.mcap."""
    parser.add_argument("recording", type=Path, metavar="RUN.mcap", nargs="?" if optional else None, help=text)


def add_json(parser: argparse.ArgumentParser, text: str = "print one JSON object") -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help=text)


def add_set(parser: argparse.ArgumentParser, text: str, metavar: str = "KEY=VALUE") -> None:
    """Add --set, whose values are ``overrides``."""
    parser.add_argument(
        "--set", action="append", default=[], dest="overrides", metavar=metavar, help=f"{text}; may be repeated"
    )


def add_log(parser: argparse.ArgumentParser) -> None:
    """Add --log."""
    parser.add_argument("--log", type=Path, metavar="IN.mcap", help="imported log that the sensors process plays")


def add_durable(parser: argparse.ArgumentParser) -> None:
    """Add --durable."""
    parser.add_argument(
        "--durable",
        action="store_true",
        help="the recorder syncs to disk before it confirms: what it has confirmed survives a loss of power",
    )


def add_clock(parser: argparse.ArgumentParser) -> None:
    """Add --clock."""
    parser.add_argument(
        "--clock",
        choices=["lockstep", "realtime"],
        help="lockstep: as fast as it goes, each tick once round all nodes; realtime: by the wall clock (default: the "
        "scenario's)",
    )


def add_connect(
    parser: argparse.ArgumentParser, option: str = "--connect", text: str = "where the router listens"
) -> None:
    """Add an option that names an endpoint of the router."""
    parser.add_argument(option, type=endpoint, metavar="tls/HOST:PORT", help=f"{text}, or tcp/HOST:PORT without keys")


def add_keys(parser: argparse.ArgumentParser) -> None:
    """Add --keys and --insecure."""
    parser.add_argument(
        "--keys", type=Path, metavar="FOLDER", help="keys and certificates of this process (dynpf keys)"
    )
    parser.add_argument("--insecure", action="store_true", help="without keys, beyond this machine: anybody may speak")


def endpoint(text: str) -> str:
    """Check an endpoint of the form tls/HOST:PORT or tcp/HOST:PORT; for argparse."""
    found = re.fullmatch(r"(tcp|tls)/(\[[0-9a-fA-F:]+\]|[^/:\s]+):(\d{1,5})", text)
    if found is None or not 0 < int(found[3]) < 2**16:
        raise argparse.ArgumentTypeError(f"{text!r}: expected tls/HOST:PORT, such as tls/127.0.0.1:{DEFAULT_PORT}")
    return text


def finite_number(text: str) -> float:
    """Read a finite number; for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def positive_count(text: str) -> int:
    """Read a whole number of at least 1; for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a number of at least 1")
    return int(text)


def speed(text: str) -> float:
    """Read a speed of at least 0; for argparse."""
    value = finite_number(text)
    if not 0.0 <= value <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text}: expected 0 to 1000")
    return value
