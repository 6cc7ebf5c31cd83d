"""``dynpf recover``: repair a recording into a new file."""

import argparse
import json
from pathlib import Path

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf recover``."""
    add_recording(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="NEW.mcap", help="the new file (RUN.recovered.mcap)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf recover`` and return its exit code."""
    import msgspec
    from dynpf_formats.capture.reader import is_capture
    from dynpf_formats.capture.recover import recover_capture
    from dynpf_formats.recording.recover import recover

    output = options.output or options.recording.with_suffix(".recovered.mcap")
    mend = recover_capture if is_capture(options.recording) else recover
    recovery = mend(options.recording, output)
    if options.json:
        print(json.dumps({"file": str(output), **msgspec.to_builtins(recovery)}))
        return 0
    state = "complete" if recovery.complete else f"incomplete, {recovery.reason}"
    print(f"{output}: {recovery.kept} messages kept, the last at {recovery.last_stamp_ns / 1e9:.3f} s; {state}")
    print(f"  {recovery.missing} messages known to be missing, {recovery.refused} refused")
    for text in recovery.damage:
        print(f"  {options.recording}: {text}")
    return 0
