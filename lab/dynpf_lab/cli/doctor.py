"""``dynpf doctor``: faults of a recording, and the code that it names."""

import argparse
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_lab.cli.arguments import add_json, add_recording

if TYPE_CHECKING:
    from dynpf_formats.recording.doctor import Diagnosis
    from dynpf_formats.recording.findings import Finding
    from dynpf_formats.recording.signature import Signed
    from dynpf_protocol.messages import Restart

__all__ = ["add_arguments"]

MOST_LINES = 20
"""How many findings are printed: a lost chunk leaves a gap in every topic."""


MOST_CHARACTERS = 2000
"""Of a finding that is printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf doctor``."""
    add_recording(parser)
    parser.add_argument(
        "--trust", type=Path, metavar="ca.pem", help="the file must be signed with a certificate of this authority"
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf doctor`` and return its exit code."""
    import msgspec
    from dynpf_formats.capture.reader import is_capture
    from dynpf_formats.recording.code import code_in_words, described_code
    from dynpf_formats.recording.doctor import Severity, diagnose
    from dynpf_formats.recording.findings import error
    from dynpf_formats.recording.signature import read_signature

    notes: list[str] = []
    if is_capture(options.recording):
        diagnosis, notes = _of_a_capture(options.recording)
    else:
        diagnosis = diagnose(options.recording)
    findings, named, _, restarts, resumable = diagnosis
    signed = read_signature(options.recording, options.trust, datetime.now(UTC))
    if signed is not None and signed.problem:
        findings.append(error(signed.problem, "signature"))
    elif signed is None and options.trust is not None:
        findings.append(error("the file is not signed", "signature"))
    code = described_code(named)
    unreadable = any(finding.severity is Severity.UNREADABLE for finding in findings)
    if options.json:
        told = {"healthy": not findings, "findings": findings, "code": code, "signed": signed}
        told |= {"restarts": restarts, "resumable": resumable} | ({"notes": notes} if notes else {})
        print(json.dumps(msgspec.to_builtins(told)))
    else:
        _print(options.recording, findings, restarts, resumable=resumable)
        for note in notes:
            print(note)
        if signed is not None or (options.trust is None and not unreadable):
            print(_signature_in_words(signed))
        for line in code_in_words(code):
            print(line)
    if unreadable:
        return 2
    return 1 if findings else 0


def _of_a_capture(path: Path) -> "tuple[Diagnosis, list[str]]":
    """Return what is wrong with a capture, and what it cannot tell."""
    from dynpf_formats.capture.reader import read_capture
    from dynpf_formats.capture.report import examine, unnumbered
    from dynpf_formats.recording.doctor import Diagnosis, Severity
    from dynpf_formats.recording.errors import RecordingError
    from dynpf_formats.recording.findings import Finding
    from dynpf_protocol.printable import printable

    try:
        capture = read_capture(path)
    except RecordingError as bad:
        what = str(bad).removeprefix(f"{path}: ")
        return Diagnosis([Finding(severity=Severity.UNREADABLE, what=what, where=str(path))]), []
    topics = unnumbered(capture.tally)
    listed = f"no numbers on {', '.join(topics)}: what was lost of these is not known"
    return Diagnosis(examine(capture)), [printable(listed, MOST_CHARACTERS)] if topics else []


def _print(recording: Path, findings: Sequence["Finding"], restarts: Sequence["Restart"], *, resumable: bool) -> None:
    from dynpf_formats.recording.info import in_words
    from dynpf_protocol.printable import printable

    if not findings:
        print(f"{recording}: whole and complete")
    for finding in findings[:MOST_LINES]:
        print(printable(f"{finding.severity}: {finding.where}: {finding.what}", MOST_CHARACTERS))
    if len(findings) > MOST_LINES:
        print(f"and {len(findings) - MOST_LINES} more, which follow from these as a rule; --json lists all")
    if any(finding.where.startswith(("byte ", "end of file")) for finding in findings):
        print(f"dynpf recover {recording} -o NEW.mcap keeps what is whole")
    if resumable:
        print(f"dynpf resume {recording} goes on with the run")
    for restart in restarts:
        print(in_words(restart))


def _signature_in_words(signed: "Signed | None") -> str:
    if signed is None:
        return "not signed"
    if not signed.name:
        return "the signature is unreadable"
    trust = "of the trusted authority" if signed.trusted else "whose authority is not checked (--trust)"
    state = f"signed by {signed.name}, {trust}" if not signed.problem else f"NOT validly signed by {signed.name}"
    return f"{state}; says at {signed.signed_at}; key {signed.fingerprint}"
