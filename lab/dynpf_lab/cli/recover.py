"""dynpf recover: mend a recording into a new file."""

import argparse

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("recover", help="write what can still be read of a recording into a new file")
    parser.add_argument("recording", metavar="RUN.mcap")
    parser.add_argument("-o", "--output", metavar="NEW.mcap", help="the new file (RUN.recovered.mcap)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from pathlib import Path

    import msgspec
    from dynpf_formats.recording.recover import recover

    output = args.output or Path(args.recording).with_suffix(".recovered.mcap")
    recovery = recover(args.recording, output)
    if args.json:
        print(msgspec.json.encode({"file": str(output), **msgspec.to_builtins(recovery)}).decode())
        return 0
    state = "complete" if recovery.complete else f"incomplete, {recovery.reason}"
    print(f"{output}: {recovery.kept} messages kept, the last at {recovery.last_stamp_ns / 1e9:.3f} s; {state}")
    print(f"  {recovery.missing} messages known to be missing, {recovery.refused} refused")
    for text in recovery.damage:
        print(f"  {args.recording}: {text}")
    return 0
