"""``dynpf explain``: why a run went as it did, in words."""

import argparse
import json

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf explain``."""
    add_recording(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf explain`` and return its exit code."""
    from dynpf_experiments.explanation import as_data, explanation, in_words
    from dynpf_formats.recording.reader import read_recording

    story = explanation(read_recording(options.recording, allow_truncated=True))
    print(json.dumps(as_data(story)) if options.json else "\n".join(in_words(story)))
    return 0
