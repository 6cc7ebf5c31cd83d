"""``dynpf references``: check reference recordings, those of a checkout or of one's own, or record them again."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_runtime.progress import show_progress

from dynpf_lab.cli.arguments import add_json
from dynpf_lab.cli.options import add_allow_code, add_code

if TYPE_CHECKING:
    from dynpf_lab.references.check import Finding
    from dynpf_lab.references.table import Table

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf references``."""
    actions = parser.add_subparsers(metavar="check|update", required=True)
    check = actions.add_parser("check", help="replay every node of every recording, and run each again")
    _add_table(check)
    add_json(check)
    check.set_defaults(run=_check)
    update = actions.add_parser("update", help="record all runs again and report the changes")
    update.add_argument("--reason", required=True, help="why the recordings may change, for the report")
    _add_table(update)
    update.set_defaults(run=_update)


def _add_table(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "A table has a row for each run: name, scenario, seed, and what came of it (docs/regression.md). Paths in it "
        "are relative to its folder, in which the recordings and the report lie, too."
    )
    parser.add_argument(
        "--table", type=Path, metavar="FILE", help="a table of yours (default: dynpf's own, of a checkout)"
    )
    add_allow_code(parser, "a scenario of the table or its recording")
    add_code(parser)


def _table(options: argparse.Namespace) -> "Table":
    from dynpf_lab.references.runs import find_code
    from dynpf_lab.references.table import REPOSITORY, read_table

    table = read_table(options.table or REPOSITORY, options.code, options.allow_code)
    find_code(table)
    return table


def _check(options: argparse.Namespace) -> int:
    import msgspec

    from dynpf_lab.references.check import check_part, parts

    table, findings = _table(options), []
    for entry, part in [(row, part) for row in table.rows for part in parts(table, row)]:
        show_progress(f"{entry.name}: {part}")
        findings.append(check_part(table, entry, part))
    show_progress("")
    same = all(finding.verdict != "differs" for finding in findings)
    if options.json:
        print(msgspec.json.encode({"same": same, "findings": findings}).decode())
    else:
        print("\n".join(map(_in_words, findings)) or f"{table.path}: has no rows, so nothing was checked")
    return 0 if same and findings else 1


def _in_words(finding: "Finding") -> str:
    verdict = "DIFFERS" if finding.verdict == "differs" else finding.verdict
    text = f"{finding.recording:<20} {finding.part:<11} {verdict:<8} {finding.note}".rstrip()
    first = finding.first
    if first is None:
        return text
    where = f"node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}"
    return f"{text}\n    first difference: {where}: recorded {first.recorded!r}, now {first.replayed!r}"


def _update(options: argparse.Namespace) -> int:
    from dynpf_lab.references.update import update

    table = _table(options)
    changes = update(table, options.reason, show=show_progress)
    show_progress("")
    if not changes:
        print("nothing changed: recordings, table and report are as they were")
        return 0
    for change in changes:
        print(f"{change.new.name}: {'recorded again' if change.old.made else 'recorded'}")
    print(f"the changes are in {table.report}")
    return 0
