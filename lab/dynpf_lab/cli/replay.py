"""``dynpf replay``: re-execute nodes from a recording and compare their output with the recorded one."""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_json, add_recording, add_set
from dynpf_lab.cli.options import add_allow_code, add_code
from dynpf_lab.cli.page import add_no_page, leave_page

if TYPE_CHECKING:
    from dynpf_formats.recording.findings import Finding
    from dynpf_formats.recording.reader import Recording
    from dynpf_runtime.replay import Mismatch, Replayed
    from dynpf_services.scenario.schema import Scenario

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf replay``."""
    parser.description = (
        "Each node gets its recorded inputs and is compared with its recorded output. With --set, nodes "
        "run with other settings: with --node, only that node, and the differences are printed; without, the whole "
        "run is repeated from its source. Code that the recording names is run only with --allow-code, and files come "
        "from the recording, except those that --set names."
    )
    add_recording(parser)
    parser.add_argument("--node", metavar="NAME", help="only this node (default: all of them)")
    add_set(parser, "override one key of the recorded scenario, such as estimator.n=500")
    add_allow_code(parser)
    add_code(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="NEW.mcap", help="write the replayed run")
    add_no_page(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf replay`` and return its exit code."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_formats.regular_files import exists
    from dynpf_services.scenario.replay import check_run, replay_nodes, rerun, scenario_of_replay, write_nodes
    from dynpf_services.scenario.user_code import add_folders, code_folders

    add_folders(code_folders(options.code))
    recording = read_recording(options.recording)
    if options.output is not None and exists(options.output):
        raise UsageError(f"{options.output}: the file exists; choose another name")
    scenario = scenario_of_replay(recording, options.node, options.overrides, options.allow_code)
    _tell_changed_code(recording, scenario)
    if options.overrides and options.node is None:
        return _compare(options, recording, lambda path: rerun(recording, scenario, path))
    keep = options.output is not None or bool(options.overrides)
    outcomes = replay_nodes(recording, scenario, options.node, keep=keep)
    if options.overrides:
        return _compare(options, recording, lambda path: write_nodes(recording, scenario, outcomes, path))
    if options.output is not None:
        write_nodes(recording, scenario, outcomes, options.output)
        _leave_page(options)
    findings, inputs = check_run(recording, scenario)
    found = [mismatch for mismatch in (inputs, *(outcome.mismatch for outcome in outcomes)) if mismatch is not None]
    _print_outcomes(recording, outcomes, findings, found, as_json=options.json)
    return 1 if found or findings else 0


def _tell_changed_code(recording: "Recording", scenario: "Scenario") -> None:
    """Warn of modules of the user's that have changed since the recorded run, which may cause differences."""
    from dynpf_services.scenario.replay import changed_code

    for module, then, digest in changed_code(recording, scenario):
        print(
            f"dynpf replay: the module {module} has changed since the run was recorded: its source is "
            f"{digest[:12]}, and was {then[:12]}; differences may come from it",
            file=sys.stderr,
        )


def _print_outcomes(
    recording: "Recording",
    outcomes: Sequence["Replayed"],
    findings: Sequence["Finding"],
    found: Sequence["Mismatch"],
    *,
    as_json: bool,
) -> None:
    import msgspec
    from dynpf_formats.recording.provenance import collect, explain_different_bytes

    # The first difference of the run is that of the earliest tick, and in it that of the first node in tick order.
    first = min(found, key=lambda outcome: outcome.tick) if found else None
    apart = explain_different_bytes(recording.header.provenance, collect()) if found else ""
    if as_json:
        counts = {
            outcome.node: {"steps": outcome.steps, "messages": outcome.messages, "digests": outcome.digests}
            for outcome in outcomes
        }
        difference = None
        if first is not None:
            difference = {**first._asdict(), "a": first.recorded, "b": first.replayed}
            del difference["recorded"], difference["replayed"]
        same = first is None and not findings
        told = msgspec.to_builtins(findings)
        document = {"same": same, "first": difference, "counts": counts, "platform": apart, "findings": told}
        print(json.dumps({**document, "complete": _incomplete(recording) is None}))
        return
    for finding in findings:
        print(f"{finding.severity}: {finding.where}: {finding.what}")
    if (reason := _incomplete(recording)) is not None:
        print(f"the run is not complete, and is compared as far as it is recorded: {reason}")
    for outcome in outcomes:
        verdict = "DIFFERS" if outcome.mismatch is not None else "altered" if findings else "same"
        print(
            f"{outcome.node:<11} {verdict:<8} {outcome.steps} steps, {outcome.messages} messages, "
            f"{outcome.digests} state digests"
        )
    if first is not None:
        print(
            f"first difference: node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}: "
            f"recorded {first.recorded!r}, replayed {first.replayed!r}"
        )
    if apart:
        print(apart)


def _incomplete(recording: "Recording") -> str | None:
    """Return why a recording says that it does not hold a whole run, or None if it does."""
    if recording.end is None:
        return "its end was never written"
    return None if recording.end.complete else recording.end.reason


def _compare(options: argparse.Namespace, recording: "Recording", write: Callable[[Path], None]) -> int:
    """Write the changed run, to the output or a temporary file, and print how it differs."""
    from dynpf_formats.recording.reader import read_recording

    from dynpf_lab.cli.diff import print_difference

    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        path = options.output or Path(folder) / "replayed.mcap"
        write(path)
        if options.output is not None:
            _leave_page(options)
        name = f"with {' '.join(options.overrides)}"
        return print_difference(recording, read_recording(path), str(options.recording), name, as_json=options.json)


def _leave_page(options: argparse.Namespace) -> None:
    """Make the page of the replayed run beside its recording, and say where it is."""
    page = None if options.no_page else leave_page("replay", options.output)
    if page is not None:
        print(f"page        {page}", file=sys.stderr)
