"""``dynpf references``: check the reference recordings of a checkout, or record them again."""

import argparse
from typing import TYPE_CHECKING

from dynpf_runtime.progress import show_progress

from dynpf_lab.cli.arguments import add_json

if TYPE_CHECKING:
    from dynpf_lab.references.check import Finding

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf references``."""
    actions = parser.add_subparsers(metavar="check|update", required=True)
    check = actions.add_parser("check", help="replay every node of every recording, and run each again")
    add_json(check)
    check.set_defaults(run=_check)
    update = actions.add_parser("update", help="record all runs again and report the changes")
    update.add_argument("--reason", required=True, help="why the recordings may change, for the report")
    update.set_defaults(run=_update)


def _check(options: argparse.Namespace) -> int:
    import msgspec

    from dynpf_lab.references.check import check_part, parts
    from dynpf_lab.references.table import read_table

    findings = []
    for entry in read_table():
        for part in parts(entry):
            show_progress(f"{entry.name}: {part}")
            findings.append(check_part(entry, part))
    show_progress("")
    same = all(finding.verdict != "differs" for finding in findings)
    if options.json:
        print(msgspec.json.encode({"same": same, "findings": findings}).decode())
    else:
        print("\n".join(map(_in_words, findings)))
    return 0 if same else 1


def _in_words(finding: "Finding") -> str:
    verdict = "DIFFERS" if finding.verdict == "differs" else finding.verdict
    text = f"{finding.recording:<20} {finding.part:<11} {verdict:<8} {finding.note}".rstrip()
    first = finding.first
    if first is None:
        return text
    where = f"node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}"
    return f"{text}\n    first difference: {where}: recorded {first.recorded!r}, now {first.replayed!r}"


def _update(options: argparse.Namespace) -> int:
    from dynpf_lab.references.table import CHECKOUT
    from dynpf_lab.references.update import report_file, update

    changes = update(options.reason, show=show_progress)
    show_progress("")
    if not changes:
        print("nothing changed: recordings, table and report are as they were")
        return 0
    for change in changes:
        print(f"{change.new.name}: {'recorded again' if change.old.made else 'recorded'}")
    print(f"the changes are in {report_file(CHECKOUT)}")
    return 0
