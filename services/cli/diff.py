"""dynpf diff: the first difference between two recordings."""

# ruff: noqa: PLC0415 (imported when run, so that the other commands need not wait)

import argparse

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("diff", help="the first difference between two recordings (exit code 1 if any)")
    parser.add_argument("a", metavar="A.mcap")
    parser.add_argument("b", metavar="B.mcap")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    import msgspec

    from services.recording.diff import diff
    from services.recording.reader import read_recording

    difference = diff(read_recording(args.a, allow_truncated=True), read_recording(args.b, allow_truncated=True))
    if args.json:
        print(msgspec.json.encode(difference).decode())
        return 0 if difference.same else 1
    first = difference.first
    if first is None:
        print(f"same: {sum(count.a for count in difference.counts.values())} messages")
        return 0
    tick = "no tick" if first.tick is None else f"tick {first.tick}"
    print(f"first difference: {tick}, node {first.node}, {first.topic} {first.sequence}, field {first.field}")
    print(f"  {args.a}: {first.a}")
    print(f"  {args.b}: {first.b}")
    for topic, count in difference.counts.items():
        print(f"  {topic}: {count.a} and {count.b} messages, {count.differ} differ")
    return 1
