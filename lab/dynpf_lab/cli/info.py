"""``dynpf info``: the contents of a recording, or of a capture (``dynpf record``)."""

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
    from dynpf_formats.capture.reader import is_capture, read_capture
    from dynpf_formats.capture.report import describe as describe_capture
    from dynpf_formats.capture.report import summary_lines
    from dynpf_formats.recording.info import describe, text
    from dynpf_formats.recording.reader import read_recording

    if is_capture(options.recording):
        told = describe_capture(read_capture(options.recording))
        print(json.dumps(told) if options.json else "\n".join(summary_lines(told)))
        return 0
    summary = describe(read_recording(options.recording, allow_truncated=True))
    print(json.dumps(summary) if options.json else text(summary))
    return 0
