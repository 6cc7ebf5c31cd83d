"""``dynpf run``: run a scenario from beginning to end, into a recording."""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import DiedAgainError, DynpfError, UsageError
from dynpf_services.scenario.schema import Scenario

from dynpf_lab.cli.arguments import add_clock, add_json
from dynpf_lab.cli.loading import loading
from dynpf_lab.cli.options import add_scenario_options, load_log, scenario_from
from dynpf_lab.cli.page import add_no_page, leave_page
from dynpf_lab.cli.processes import add_runner, run_processes
from dynpf_lab.cli.sign import add_sign, check_key, sign_recording
from dynpf_lab.cli.watch import add_watch, begins_at, check_watch, seen_off, watcher

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dynpf_runtime.bus.processes import Companion
    from dynpf_runtime.node import Node
    from dynpf_runtime.plan import Plan
    from dynpf_services.scenario.played_log import PlayedLog

__all__ = [
    "add_arguments",
    "check_output",
    "default_output",
    "print_summary",
    "run_in_process",
    "tell_doubts",
    "tell_given",
]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf run``."""
    add_scenario_options(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="RUN.mcap", help="the recording to write (default: runs/)")
    add_clock(parser)
    add_runner(parser)
    add_watch(parser)
    add_sign(parser)
    add_no_page(parser)
    add_json(parser, "print the metrics of the run as JSON")
    parser.set_defaults(run=run)


def default_output(scenario: str, seed: int) -> Path:
    """Return an unused path in ``runs/``; raises UsageError if that folder cannot be made."""
    folder = Path("runs")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}; choose the recording with -o") from error
    now = datetime.now()  # to the millisecond, for runs that begin in the same second
    return folder / f"{scenario}-{seed}-{now:%Y%m%d-%H%M%S}-{now.microsecond // 1000:03d}.mcap"


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf run`` and return its exit code."""
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.record import check_log

    with loading():
        log = load_log(options)
        scenario = scenario_from(options, log)
    check_log(scenario, options.log)
    if options.runner == "inline" and scenario.clock == "realtime":
        raise UsageError("--runner inline goes in lockstep only; a realtime run needs --runner bus")
    check_watch(options)
    path = options.output or default_output(Path(options.scenario).stem, scenario.seed)
    check_output(path)
    if options.sign is not None:
        check_key(options.sign)
    with loading():
        plan = plan_of(scenario)
        nodes = [spec.build() for spec in plan.graph.specs.values()]  # errors are reported here, before any process
    tell_doubts("run", nodes)
    with seen_off(watcher(options)) as companion:
        return _run(scenario, plan, (path, log), options, companion)


def _run(
    scenario: Scenario,
    plan: "Plan",
    files: "tuple[Path, PlayedLog | None]",
    options: argparse.Namespace,
    companion: "Companion | None",
) -> int:
    path, log = files
    try:
        if options.runner == "inline":
            run_in_process(scenario, path, log, durable=options.durable)
        else:
            _run_on_bus(scenario, plan, files, options, companion)
    except DynpfError as error:
        if path.is_file():
            if isinstance(error, DiedAgainError):
                tell_given("run", path, plan, error)
            if options.sign is not None:
                sign_recording(path, options.sign)
            page = None if options.no_page else leave_page("run", path)
            shown = "" if page is None else f", {page} shows them"
            print(
                f"dynpf run: the messages recorded so far are in {path}{shown} (dynpf doctor tells what is missing)",
                file=sys.stderr,
            )
        raise
    if options.sign is not None:
        sign_recording(path, options.sign)
    return print_summary("run", path, with_page=not options.no_page, as_json=options.json)


def tell_given(command: str, path: Path, plan: "Plan", error: DiedAgainError) -> None:
    """Tell what the step was given in which a node has died twice."""
    from dynpf_formats.recording.reader import read_recording
    from dynpf_runtime.given import given

    if error.node not in plan.graph.nodes:
        return
    recording = read_recording(path, allow_truncated=True)
    told = ", ".join(f"{topic} {sequence}" for topic, sequence in given(recording, plan, error.node, error.tick))
    print(
        f"dynpf {command}: the step of tick {error.tick} of {error.node} ends so whenever it is made; it is given "
        f"{told or 'no message'}",
        file=sys.stderr,
    )


def check_output(path: Path) -> None:
    """Raise UsageError for an unusable output, before any process is started."""
    try:
        with path.open("xb"):
            pass
        path.unlink()
    except FileExistsError as error:
        raise UsageError(f"{path}: the file exists; choose another name") from error
    except (OSError, ValueError) as error:  # too long, not permitted, a byte 0
        if not path.parent.is_dir():
            raise UsageError(f"{path}: the folder {path.parent} does not exist") from error
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(f"{path}: cannot be written: {reason}; choose another name with -o") from error


def tell_doubts(command: str, nodes: "Iterable[Node]") -> None:
    """Print what nodes find probably wrong before a run."""
    from dynpf_runtime.node import Doubting

    for node in nodes:
        if isinstance(node, Doubting):
            for doubt in node.doubts():
                print(f"dynpf {command}: warning: {node.name}: {doubt}", file=sys.stderr)


def run_in_process(scenario: Scenario, path: Path, log: "PlayedLog | None", *, durable: bool = False) -> None:
    """Run a scenario in this process into a recording; a signal ends it as a whole one."""
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_services.scenario.record import record_inline

    with StopSignal.installed() as stop:
        record_inline(scenario, path, log, stopped=lambda: stop.reason if stop.requested else "", durable=durable)


def _run_on_bus(
    scenario: Scenario,
    plan: "Plan",
    files: "tuple[Path, PlayedLog | None]",
    options: argparse.Namespace,
    companion: "Companion | None",
) -> None:
    from dynpf_services.scenario.user_code import code_folders

    speed = begins_at(options, plan.rate)
    run_processes(
        scenario,
        plan,
        *files,
        code_folders(options.code, options.scenario),
        secure=not options.insecure,
        guests=options.keys,
        restarts=options.restarts,
        durable=options.durable,
        further={} if speed is None else {plan.graph.source: ["--speed", f"{speed:g}"]},
        companion=companion,
    )


def print_summary(command: str, path: Path, *, with_page: bool, as_json: bool) -> int:
    """Print what became of a run of a command, and return the exit code."""
    from dynpf_experiments.measures import described, measure, summary
    from dynpf_formats.recording.reader import read_recording

    recording = read_recording(path)
    measures = measure(recording)
    if not as_json:
        print(summary(recording, measures), flush=True)  # before the page, which takes a moment
    page = leave_page(command, path, recording, measures) if with_page else None
    if as_json:
        print(json.dumps({**described(recording), **({} if page is None else {"page": str(page)}), **measures}))
    elif page is not None:
        print(f"page        {page}")
    return 0 if measures["complete"] else 1
