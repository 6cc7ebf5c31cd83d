"""``dynpf metrics``: a recorded run against the truth in it."""

import argparse
import json
from pathlib import Path
from typing import Any

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("metrics", help="a recorded run against the truth in it")
    parser.add_argument("recording", type=Path, metavar="RUN.mcap")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from dynpf_experiments.measures import measure, summary
    from dynpf_formats.recording.reader import read_recording

    recording = read_recording(options.recording)
    measures = measure(recording)
    print(json.dumps(measures) if options.json else summary(recording, measures))
    return 0
