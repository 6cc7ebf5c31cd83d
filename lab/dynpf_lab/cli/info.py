"""``dynpf info``: the contents of a recording, or of a capture (``dynpf record``)."""

import argparse
import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import DynpfError

from dynpf_lab.cli.arguments import add_json, add_recording

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording

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
    recording = read_recording(options.recording, allow_truncated=True)
    summary = describe(recording)
    if options.json:
        print(json.dumps({**_of_run(recording), **summary}))
        return 0
    print(text(summary))
    if lines := _measured(recording):
        print("\n".join(f"  {line}" for line in lines))
    return 0


def _of_run(recording: "Recording") -> dict[str, Any]:
    """Return clock, kinds and settings of the nodes of a run; nothing of an imported log."""
    from dynpf_experiments.measures import described

    with suppress(DynpfError):
        known = described(recording)
        return {name: known[name] for name in ("scenario", "clock", "kinds", "settings", "estimates")}
    return {}


def _measured(recording: "Recording") -> list[str]:
    """Return what a run's measures say, in a few lines; nothing of an imported log."""
    from dynpf_experiments.measures import lines_of, measure_run
    from dynpf_experiments.messages import recorded

    with suppress(DynpfError):
        return lines_of(measure_run(recorded(recording)))
    return []
