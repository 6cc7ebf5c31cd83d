"""``dynpf info``: the contents of a recording."""

import argparse
import json

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf info``."""
    add_recording(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf info`` and return its exit code."""
    from dynpf_formats.recording.info import describe, text
    from dynpf_formats.recording.reader import read_recording

    summary = describe(read_recording(options.recording, allow_truncated=True))
    print(json.dumps(summary) if options.json else text(summary))
    return 0
