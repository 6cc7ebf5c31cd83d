"""dynpf diff: the first difference between two recordings."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.recording.diff import Difference

__all__ = ["add_parser", "print_difference"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("diff", help="the first difference between two recordings (exit code 1 if any)")
    parser.add_argument("a", metavar="A.mcap")
    parser.add_argument("b", metavar="B.mcap")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from services.recording.diff import diff
    from services.recording.reader import read_recording

    difference = diff(read_recording(args.a, allow_truncated=True), read_recording(args.b, allow_truncated=True))
    return print_difference(difference, args.a, args.b, as_json=args.json)


def print_difference(difference: "Difference", a: str, b: str, *, as_json: bool) -> int:
    """Print where recordings ``a`` and ``b`` first differ, and return the command's exit code."""
    import msgspec

    if as_json:
        print(msgspec.json.encode(difference).decode())
        return 0 if difference.same else 1
    first = difference.first
    if first is None:
        print(f"same: {sum(count.a for count in difference.counts.values())} messages")
        return 0
    tick = "no tick" if first.tick is None else f"tick {first.tick}"
    print(f"first difference: {tick}, node {first.node}, {first.topic} {first.sequence}, field {first.field}")
    print(f"  {a}: {first.a}")
    print(f"  {b}: {first.b}")
    for topic, count in difference.counts.items():
        print(f"  {topic}: {count.a} and {count.b} messages, {count.differ} differ")
    return 1
