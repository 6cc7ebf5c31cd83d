"""``dynpf diff``: the first difference between two recordings, and the differences of their measures."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_lab.cli.arguments import add_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dynpf_formats.recording.diff import TopicCounts
    from dynpf_formats.recording.reader import Recording

__all__ = ["add_arguments", "print_difference"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf diff``."""
    parser.add_argument("a", type=Path, metavar="A.mcap", help="the recording of a run")
    parser.add_argument("b", type=Path, metavar="B.mcap", help="the recording that it is compared with")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf diff`` and return its exit code."""
    from dynpf_formats.recording.reader import read_recording

    a, b = (read_recording(path, allow_truncated=True) for path in (options.a, options.b))
    return print_difference(a, b, str(options.a), str(options.b), as_json=options.json)


def print_difference(
    a: "Recording",
    b: "Recording",
    a_name: str,
    b_name: str,
    *,
    as_json: bool,
    heads: tuple[str, str] = ("A", "B"),
) -> int:
    """Print the first difference of two recordings and their different measures; return the exit code.

    ``heads`` are what the columns of the tables are called.
    """
    import msgspec
    from dynpf_experiments.measure_table import before_and_after, changes_of
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
    print("\n".join(_counts(difference.counts, heads)))
    if metrics:
        before, after = ({name: pair[side] for name, pair in metrics.items()} for side in (0, 1))
        print("\n".join(before_and_after(changes_of(before, after), heads)))
    if apart:
        print(apart)
    return 1


def _counts(counts: "Mapping[str, TopicCounts]", heads: tuple[str, str]) -> list[str]:
    """Return a table of the messages of each topic in both recordings, and how many differ."""
    width = max(map(len, counts))
    lines = [f"{'messages':<{width}}  {heads[0]:>8}  {heads[1]:>8}  {'differ':>8}"]
    return lines + [f"{topic:<{width}}  {row.a:>8}  {row.b:>8}  {row.differ:>8}" for topic, row in counts.items()]
