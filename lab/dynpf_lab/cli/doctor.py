"""``dynpf doctor``: faults of a recording, and the code that it names."""

import argparse
import json

from dynpf_lab.cli.arguments import add_json, add_recording

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf doctor``."""
    add_recording(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf doctor`` and return its exit code."""
    import msgspec
    from dynpf_formats.recording.code import code_in_words, described_code
    from dynpf_formats.recording.doctor import Severity, diagnose

    findings, named = diagnose(options.recording)
    code = described_code(named)
    if options.json:
        print(json.dumps(msgspec.to_builtins({"healthy": not findings, "findings": findings, "code": code})))
    else:
        if not findings:
            print(f"{options.recording}: whole and complete")
        for finding in findings:
            print(f"{finding.severity}: {finding.where}: {finding.what}")
        for line in code_in_words(code):
            print(line)
    if any(finding.severity is Severity.UNREADABLE for finding in findings):
        return 2
    return 1 if findings else 0
