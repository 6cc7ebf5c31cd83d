"""dynpf doctor: what is wrong with a recording, and what code it names."""

import argparse

__all__ = ["add_parser"]


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser("doctor", help="what is wrong with a recording (exit code 1 if anything is)")
    parser.add_argument("recording", metavar="RUN.mcap")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    import msgspec
    from dynpf_formats.recording.code import code_in_words, described_code
    from dynpf_formats.recording.doctor import Severity, diagnose

    findings, named = diagnose(args.recording)
    code = described_code(named)
    if args.json:
        print(msgspec.json.encode({"healthy": not findings, "findings": findings, "code": code}).decode())
    else:
        if not findings:
            print(f"{args.recording}: whole and complete")
        for finding in findings:
            print(f"{finding.severity}: {finding.where}: {finding.what}")
        for line in code_in_words(code):
            print(line)
    if any(finding.severity is Severity.UNREADABLE for finding in findings):
        return 2
    return 1 if findings else 0
