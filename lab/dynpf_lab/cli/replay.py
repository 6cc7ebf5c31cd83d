"""``dynpf replay``: re-execute nodes from a recording and compare what they do with what they did."""

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.options import add_allow_code, add_code, code_folders

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording
    from dynpf_runtime.replay import Replayed
    from dynpf_services.scenario.schema import Scenario

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser(
        "replay",
        help="re-execute nodes from a recording and compare",
        description="Each node gets its recorded inputs and is compared with its recorded output. With --set, nodes "
        "run with other settings: with --node, that node alone, and the differences are printed; without, the whole "
        "run anew from its source. Code that the recording names is run only with --allow-code, and files come from "
        "the recording, save those that --set names.",
    )
    parser.add_argument("recording", type=Path, metavar="RUN.mcap")
    parser.add_argument("--node", metavar="NAME", help="only this node (default: all of them)")
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    add_allow_code(parser)
    add_code(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="NEW.mcap", help="write the replayed run")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from dynpf_formats.recording.reader import read_recording
    from dynpf_services.scenario.recorded import recorded_scenario
    from dynpf_services.scenario.schema import key_of
    from dynpf_services.scenario.user_code import add_folders, check_allowed

    add_folders(code_folders(options))
    recording = read_recording(options.recording)
    if options.output is not None and options.output.exists():
        raise UsageError(f"{options.output}: the file exists; choose another name")
    scenario = recorded_scenario(recording, options.overrides, options.allow_code)
    named = scenario.user_classes
    if options.node is not None:
        named = tuple(user for user in named if user.key.startswith(f"{key_of(options.node)}."))
    check_allowed(named, scenario.user_code, str(options.recording))
    _tell_changed_code(recording, scenario)
    if options.overrides and options.node is None:
        return _closed_loop(options, recording, scenario)
    if options.node is not None and options.node not in scenario.nodes:
        raise UsageError(
            f"{options.recording}: has no node {options.node!r}; its nodes are {', '.join(scenario.nodes)}"
        )
    return _each_alone(options, recording, scenario)


def _tell_changed_code(recording: "Recording", scenario: "Scenario") -> None:
    """Say which modules of the user's are not those that the recorded run was made with: differences may be theirs."""
    recorded = _recorded_digests(recording)
    for module, digest in scenario.user_code.items():
        if (then := recorded.get(module)) not in (None, digest):
            print(
                f"dynpf replay: the module {module} has changed since the run was recorded: its source is "
                f"{digest[:12]}, and was {then[:12]}; what differs may be its doing",
                file=sys.stderr,
            )


def _recorded_digests(recording: "Recording") -> dict[str, str]:
    """Return the digests of the user's modules with which the recorded run was made, by module."""
    return dict(json.loads(recording.header.scenario).get("user_code", {}))


def _each_alone(options: argparse.Namespace, recording: "Recording", scenario: "Scenario") -> int:
    from dynpf_runtime.replay import replay_node
    from dynpf_services.scenario.build import plan_of

    plan = plan_of(scenario)
    keep = options.output is not None or bool(options.overrides)
    nodes = (options.node,) if options.node else plan.graph.nodes
    outcomes = [replay_node(recording, plan, node, keep=keep) for node in nodes]
    if options.overrides:
        return _compare(options, recording, lambda path: _write(recording, scenario, outcomes, path))
    if options.output is not None:
        _write(recording, scenario, outcomes, options.output)
    _print_outcomes(recording, outcomes, as_json=options.json)
    return 0 if all(outcome.mismatch is None for outcome in outcomes) else 1


def _write(recording: "Recording", scenario: "Scenario", outcomes: Sequence["Replayed"], path: Path) -> None:
    import msgspec
    from dynpf_formats.recording.writer import RecordingWriter
    from dynpf_runtime.plan import run_header
    from dynpf_runtime.replay import write_replayed
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.recorded import attachments_of
    from dynpf_services.scenario.schema import resolved_json

    recorded = _recorded_digests(recording)
    # Of code that was not run now, the digest says with which the rest of the recording was made. It is told only: a
    # scenario that held it would have it imported.
    known = {one.module: digest for one in scenario.user_classes if (digest := recorded.get(one.module))}
    told = msgspec.structs.replace(scenario, user_code={**known, **scenario.user_code})
    plan = plan_of(scenario)._replace(text=resolved_json(told))
    attachments = attachments_of(scenario, recording.attachments)
    topics, schemas = plan.graph.topics, recording.schemas
    with RecordingWriter(path, run_header(plan), attachments, topics=topics, schemas=schemas) as writer:
        write_replayed(recording, outcomes, writer)
        whole = recording.end is not None and recording.end.complete
        writer.close(complete=whole, reason=f"replayed from {recording.path.name}")


def _print_outcomes(recording: "Recording", outcomes: Sequence["Replayed"], *, as_json: bool) -> None:
    from dynpf_formats.recording.provenance import collect, told_where_bytes_differ

    # The first difference of the run is the one of the earliest tick, and in it of the first node in tick order.
    found = [outcome.mismatch for outcome in outcomes if outcome.mismatch is not None]
    first = min(found, key=lambda one: one.tick) if found else None
    apart = told_where_bytes_differ(recording.header.provenance, collect()) if found else ""
    if as_json:
        counts = {one.node: {"steps": one.steps, "messages": one.messages, "digests": one.digests} for one in outcomes}
        told = None
        if first is not None:
            told = {**first._asdict(), "a": first.recorded, "b": first.replayed}
            del told["recorded"], told["replayed"]
        print(json.dumps({"same": first is None, "first": told, "counts": counts, "platform": apart}))
        return
    for one in outcomes:
        verdict = "same" if one.mismatch is None else "DIFFERS"
        print(f"{one.node:<11} {verdict:<8} {one.steps} steps, {one.messages} messages, {one.digests} state digests")
    if first is not None:
        print(
            f"first difference: node {first.node}, tick {first.tick}, {first.topic} {first.sequence}, {first.field}: "
            f"recorded {first.recorded!r}, replayed {first.replayed!r}"
        )
    if apart:
        print(apart)


def _closed_loop(options: argparse.Namespace, recording: "Recording", scenario: "Scenario") -> int:
    if scenario.clock != "lockstep":
        raise UsageError(
            "a realtime run cannot be run anew from its source; choose --node to change one node's settings"
        )

    def run_anew(path: Path) -> None:
        from dynpf_services.scenario.played_log import log_records
        from dynpf_services.scenario.record import LogContent, record_inline

        log = LogContent(log_records(recording), recording.attachments)
        record_inline(scenario, path, log, reason=f"run anew from {recording.path.name}")

    return _compare(options, recording, run_anew)


def _compare(options: argparse.Namespace, recording: "Recording", write: Callable[[Path], None]) -> int:
    """Write the changed run, to where it is wanted or for the comparison alone, and print how it differs."""
    from dynpf_formats.recording.reader import read_recording

    from dynpf_lab.cli.diff import print_difference

    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        path = options.output or Path(folder) / "replayed.mcap"
        write(path)
        name = f"with {' '.join(options.overrides)}"
        return print_difference(recording, read_recording(path), str(options.recording), name, as_json=options.json)
