"""dynpf diff: the first difference between two recordings, and what it comes to in their measures."""

import argparse
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording

__all__ = ["add_parser", "print_difference"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("diff", help="the first difference between two recordings (exit code 1 if any)")
    parser.add_argument("a", metavar="A.mcap")
    parser.add_argument("b", metavar="B.mcap")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from dynpf_formats.recording.reader import read_recording

    a, b = (read_recording(path, allow_truncated=True) for path in (args.a, args.b))
    return print_difference(a, b, args.a, args.b, as_json=args.json)


def print_difference(a: "Recording", b: "Recording", a_name: str, b_name: str, *, as_json: bool) -> int:
    """Print where two recordings first differ and which of their measures do; return the command's exit code."""
    import msgspec
    from dynpf_experiments.measures import differing
    from dynpf_formats.recording.diff import diff
    from dynpf_formats.recording.provenance import explain_different_bytes

    difference, metrics = diff(a, b), differing(a, b)
    apart = ""
    if not difference.same and a.header.scenario == b.header.scenario:
        apart = explain_different_bytes(a.header.provenance, b.header.provenance, b_name)
    if as_json:
        print(json.dumps({**msgspec.to_builtins(difference), "metrics": metrics, "platform": apart}))
        return 0 if difference.same else 1
    first = difference.first
    if first is None:
        print(f"same: {sum(count.a for count in difference.counts.values())} messages")
        return 0
    tick = "no tick" if first.tick is None else f"tick {first.tick}"
    print(f"first difference: {tick}, node {first.node}, {first.topic} {first.sequence}, field {first.field}")
    print(f"  {a_name}: {first.a}")
    print(f"  {b_name}: {first.b}")
    for topic, count in difference.counts.items():
        print(f"  {topic}: {count.a} and {count.b} messages, {count.differ} differ")
    for name, (left, right) in metrics.items():
        print(f"  {name}: {left} and {right}")
    if apart:
        print(apart)
    return 1
