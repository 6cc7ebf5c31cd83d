"""dynpf info: what is in a recording."""

import argparse

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("info", help="what is in a recording")
    parser.add_argument("recording", metavar="RUN.mcap")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    import msgspec
    from dynpf_formats.recording.info import describe, text
    from dynpf_formats.recording.reader import read_recording

    summary = describe(read_recording(args.recording, allow_truncated=True))
    print(msgspec.json.encode(summary).decode() if args.json else text(summary))
    return 0
