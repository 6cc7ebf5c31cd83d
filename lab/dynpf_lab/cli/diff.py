"""``dynpf diff``: the first difference between two recordings, and the differences of their measures."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_lab.cli.arguments import add_json

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording

__all__ = ["add_arguments", "print_difference"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf diff``."""
    parser.add_argument("a", type=Path, metavar="A.mcap")
    parser.add_argument("b", type=Path, metavar="B.mcap")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf diff`` and return its exit code."""
    from dynpf_formats.recording.reader import read_recording

    a, b = (read_recording(path, allow_truncated=True) for path in (options.a, options.b))
    return print_difference(a, b, str(options.a), str(options.b), as_json=options.json)


def print_difference(a: "Recording", b: "Recording", a_name: str, b_name: str, *, as_json: bool) -> int:
    """Print the first difference of two recordings and their different measures; return the exit code."""
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
