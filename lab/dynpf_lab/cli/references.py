"""``dynpf references``: check the reference recordings of a checkout, or make them anew."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynpf_lab.references.check import Finding

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("references", help="check or make anew the reference recordings of a checkout")
    actions = parser.add_subparsers(metavar="check|update", required=True)
    check = actions.add_parser("check", help="replay every recording against every node, and make its run anew")
    check.add_argument("--json", action="store_true", help="print one JSON object")
    check.set_defaults(run=_check)
    update = actions.add_parser("update", help="make all recordings anew and report what changed")
    update.add_argument("--reason", required=True, help="why what the recordings hold may change, for the report")
    update.set_defaults(run=_update)


def _check(options: argparse.Namespace) -> int:
    import msgspec

    from dynpf_lab.references.check import check_part, parts
    from dynpf_lab.references.table import read_table

    findings = []
    for entry in read_table():
        for part in parts(entry):
            _show(f"{entry.name}: {part}")
            findings.append(check_part(entry, part))
    _show("")
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
    place = f"node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}"
    return f"{text}\n    first difference: {place}: recorded {first.recorded!r}, now {first.replayed!r}"


def _update(options: argparse.Namespace) -> int:
    from dynpf_lab.references.table import CHECKOUT
    from dynpf_lab.references.update import report_file, update

    changes = update(options.reason, show=_show)
    _show("")
    if not changes:
        print("nothing changed: recordings, table and report are as they were")
        return 0
    for change in changes:
        print(f"{change.new.name}: {'made anew' if change.old.made else 'made'}")
    print(f"what changed is told in {report_file(CHECKOUT)}")
    return 0


def _show(text: str) -> None:
    """Tell a person who watches what is being done."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
