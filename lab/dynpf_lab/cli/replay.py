"""``dynpf replay``: re-execute nodes from a recording and compare their output with the recorded one."""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, NamedTuple

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_connect, add_json, add_keys, add_recording, add_set
from dynpf_lab.cli.options import add_allow_code, add_code
from dynpf_lab.cli.page import add_no_page, leave_page

if TYPE_CHECKING:
    from dynpf_formats.recording.findings import Finding
    from dynpf_formats.recording.reader import Recording
    from dynpf_runtime.replay import Mismatch, Replayed
    from dynpf_services.scenario.schema import Scenario

__all__ = ["add_arguments"]


class Speeds(NamedTuple):
    """How many times faster than in the run its nodes were executed and compared; and, of a whole run, ``checked``."""

    executed: float
    checked: float | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf replay``."""
    parser.description = (
        "Each node gets its recorded inputs and is compared with its recorded output. With --set, nodes "
        "run with other settings: with --node, only that node, and the differences are printed; without, the whole "
        "run is repeated from its source. Code that the recording names is run only with --allow-code, and files come "
        "from the recording, except those that --set names."
    )
    add_recording(
        parser, optional=True, text="the recording; with --follow the one that is being written, or a run's folder"
    )
    parser.add_argument(
        "--follow",
        action="store_true",
        help="a twin of a run that goes on: listen to it as an observer, execute every step again and compare every "
        "byte until it ends; the exit code is 1 with the first divergence, or if not all could be executed",
    )
    add_connect(parser, text="with --follow, where the router listens")
    add_keys(parser)
    parser.add_argument(
        "--node",
        metavar="NAME",
        help="only this node (default: all of them); with --at NAME=MODULE:CLASS, which takes the node's place",
    )
    for option, name, what in (("--from", "first", "begin"), ("--until", "last", "end")):
        parser.add_argument(
            option,
            dest=name,
            metavar="TIME",
            help=f"{what} there, such as 120s after the run's first step, or tick:500; nodes go on from their last "
            "snapshots before, and only what is needed is read and checked",
        )
    parser.add_argument(
        "--at",
        metavar="TIME",
        help="what if: the run as it was up to there, then with --set or another --node in closed loop to its end, "
        "compared with the run as it was",
    )
    add_set(parser, "override one key of the recorded scenario, such as estimator.n=500")
    add_allow_code(parser)
    add_code(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="NEW.mcap", help="write the replayed run")
    add_no_page(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf replay`` and return its exit code."""
    from dynpf_services.scenario.user_code import add_folders, code_folders

    add_folders(code_folders(options.code))
    if options.at is not None or options.first is not None:
        # A snapshot may be anybody's work: no index in it leads a kernel out of an array. Read when numba is imported.
        os.environ["NUMBA_BOUNDSCHECK"] = "1"
    if options.follow:
        from dynpf_lab.cli.follow import follow

        return follow(options)
    _check_recorded(options)
    if options.at is not None:
        from dynpf_lab.cli.what_if import print_branch

        return print_branch(options)
    if options.first is not None or options.last is not None:
        return _replay_part(options)
    return _replay_whole(options)


def _check_recorded(options: argparse.Namespace) -> None:
    """Raise UsageError if there is no recording, or for options that do nothing without --follow."""
    if options.recording is None:
        raise UsageError("name the recording, RUN.mcap; only --follow goes without it")
    if options.connect is not None or options.keys is not None or options.insecure:
        raise UsageError("--connect, --keys and --insecure are for --follow: a recording is read without a bus")


def _replay_whole(options: argparse.Namespace) -> int:
    """Replay a run from its beginning, and return the exit code."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_formats.regular_files import exists
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.replay import check_run, replay_nodes, rerun, scenario_of_replay, write_nodes
    from dynpf_services.scenario.replay_part import rehearse_nodes, speed_of

    recording = read_recording(options.recording)
    if options.output is not None and exists(options.output):
        raise UsageError(f"{options.output}: the file exists; choose another name")
    scenario = scenario_of_replay(recording, options.node, options.overrides, options.allow_code)
    _tell_changed_code(recording, scenario)
    if options.overrides and options.node is None:
        return _compare(options, recording, lambda path: rerun(recording, scenario, path))
    keep = options.output is not None or bool(options.overrides)
    rehearse_nodes(plan_of(scenario), options.node)
    began_s = process_time()
    outcomes = replay_nodes(recording, scenario, options.node, keep=keep)
    executed_s = process_time() - began_s
    if options.overrides:
        return _compare(options, recording, lambda path: write_nodes(recording, scenario, outcomes, path))
    if options.output is not None:
        write_nodes(recording, scenario, outcomes, options.output)
        _leave_page(options)
    began_s = process_time()
    findings, inputs = check_run(recording, scenario)
    checked_s = process_time() - began_s
    speeds = Speeds(speed_of(outcomes, executed_s), speed_of(outcomes, executed_s + checked_s))
    found = [mismatch for mismatch in (inputs, *(outcome.mismatch for outcome in outcomes)) if mismatch is not None]
    _print_outcomes(recording, outcomes, findings, found, speeds=speeds, as_json=options.json)
    return 1 if found or findings else 0


def _replay_part(options: argparse.Namespace) -> int:
    """Replay a part of a run, and return the exit code."""
    from dynpf_services.scenario.replay_part import moment_of, replay_parts, speed_of

    if options.overrides or options.output is not None:
        raise UsageError("--from and --until execute a part of the run as it was: they go without --set and -o")
    first, last = (None if text is None else moment_of(text) for text in (options.first, options.last))
    part = replay_parts(options.recording, options.node, first, last, options.allow_code)
    _tell_changed_code(part.recording, part.scenario)
    if part.unread:
        print(f"dynpf replay: {part.unread}: the whole file is read and checked instead", file=sys.stderr)
    outcomes = [node.outcome for node in part.nodes]
    found = [one for one in (part.inputs, *(outcome.mismatch for outcome in outcomes)) if one is not None]
    speeds = Speeds(speed_of(outcomes, part.processor_s))
    snapshots = {node.outcome.node: node.snapshot for node in part.nodes}
    _print_outcomes(
        part.recording, outcomes, part.findings, found, speeds=speeds, as_json=options.json, snapshots=snapshots
    )
    return 1 if found or part.findings else 0


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
    speeds: Speeds,
    as_json: bool,
    snapshots: Mapping[str, int | None] | None = None,
) -> None:
    """Print the results; ``snapshots`` has the step of the snapshot from which each node of a part went on, or None."""
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
        document |= {"complete": _incomplete(recording) is None, "speed": round(speeds.executed, 1)}
        if speeds.checked is not None:
            document["speed_checked"] = round(speeds.checked, 1)
        print(json.dumps(document if snapshots is None else {**document, "snapshots": snapshots}))
        return
    for finding in findings:
        print(f"{finding.severity}: {finding.where}: {finding.what}")
    if (reason := _incomplete(recording)) is not None:
        print(f"the run is not complete, and is compared as far as it is recorded: {reason}")
    for outcome in outcomes:
        verdict = "DIFFERS" if outcome.mismatch is not None else "altered" if findings else "same"
        step = None if snapshots is None else snapshots[outcome.node]
        print(
            f"{outcome.node:<11} {verdict:<8} {outcome.steps} steps, {outcome.messages} messages, "
            f"{outcome.digests} state digests{'' if step is None else f', from the snapshot after step {step}'}"
        )
    if first is not None:
        print(
            f"first difference: node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}: "
            f"recorded {first.recorded!r}, replayed {first.replayed!r}"
        )
    if apart:
        print(apart)
    checked = "" if speeds.checked is None else f"; {speeds.checked:.0f} times with the check of journals and seal"
    print(f"{speeds.executed:.0f} times real time on one core, start-up excluded{checked}")


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
        after = read_recording(path)
        heads = ("before", "after")
        return print_difference(recording, after, str(options.recording), name, as_json=options.json, heads=heads)


def _leave_page(options: argparse.Namespace) -> None:
    """Make the page of the replayed run beside its recording, and say where it is."""
    page = None if options.no_page else leave_page("replay", options.output)
    if page is not None:
        print(f"page        {page}", file=sys.stderr)
