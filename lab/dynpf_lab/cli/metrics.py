"""``dynpf metrics``: measures of a recorded run against its truth."""

import argparse
import json

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf metrics``."""
    add_recording(parser)
    parser.add_argument(
        "--truth-align",
        action="store_true",
        help="first move the reference, as a whole, as close to the estimates as it goes: for one in another frame",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf metrics`` and return its exit code."""
    from dynpf_experiments.measure_table import table_of
    from dynpf_experiments.measures import described, measure, summary
    from dynpf_formats.recording.reader import read_recording

    recording = read_recording(options.recording)
    measures = measure(recording, truth_align=options.truth_align)
    if options.json:
        print(json.dumps({**described(recording), **measures}))
        return 0
    print(summary(recording, measures))
    if options.truth_align:
        print("            against the reference moved into the frame of the estimate (--truth-align)")
    if rows := table_of(measures):
        print("\n" + "\n".join(rows))
    return 0
