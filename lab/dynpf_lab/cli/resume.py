"""``dynpf resume``: go on with a run that was stopped, or of which everything was killed, from its recording."""

import argparse
import os
import sys
from typing import TYPE_CHECKING

from dynpf_protocol.errors import DiedAgainError, DynpfError

from dynpf_lab.cli.arguments import add_json, add_log, add_recording
from dynpf_lab.cli.loading import loading
from dynpf_lab.cli.options import add_allow_code, add_code, load_log
from dynpf_lab.cli.page import add_no_page
from dynpf_lab.cli.processes import add_runner, run_processes
from dynpf_lab.cli.run import print_summary, tell_given

if TYPE_CHECKING:
    from dynpf_services.scenario.played_log import PlayedLog
    from dynpf_services.scenario.schema import Scenario

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf resume``."""
    parser.description = (
        "Goes on with a lockstep run that was stopped, whose processes were all killed, or whose machine lost power: "
        "from the last tick that its recording has of all nodes, into the same file, to the bytes of an undisturbed "
        "run. Code that the recording names is run only with --allow-code, and files come from the recording."
    )
    add_recording(parser)
    add_log(parser)
    add_allow_code(parser)
    add_code(parser)
    add_runner(parser)
    add_no_page(parser)
    add_json(parser, "print the metrics of the run as JSON")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf resume`` and return its exit code."""
    # A snapshot in a file may be anybody's work: no index in it leads a kernel out of an array. Read with numba.
    os.environ["NUMBA_BOUNDSCHECK"] = "1"
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.resume import resumable
    from dynpf_services.scenario.user_code import add_folders, code_folders

    with loading():
        add_folders(code_folders(options.code))
        log = load_log(options)
        scenario = resumable(options.recording, log, options.allow_code)
        for spec in plan_of(scenario).graph.specs.values():
            spec.build()  # errors are reported here, before any process is started
    try:
        if options.runner == "inline":
            _inline(options, scenario, log)
        else:
            _on_bus(options, scenario, log)
    except DynpfError as error:
        if isinstance(error, DiedAgainError):
            tell_given("resume", options.recording, plan_of(scenario), error)
        print(f"dynpf resume: all that was recorded is in {options.recording}", file=sys.stderr)
        raise
    return print_summary("resume", options.recording, with_page=not options.no_page, as_json=options.json)


def _inline(options: argparse.Namespace, scenario: "Scenario", log: "PlayedLog | None") -> None:
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_services.scenario.resume import resume_inline

    with StopSignal.installed() as stop:
        tick = resume_inline(
            options.recording,
            scenario,
            log,
            stopped=lambda: stop.reason if stop.requested else "",
            durable=options.durable,
        )
    print(f"dynpf resume: the run went on from tick {tick}", file=sys.stderr)


def _on_bus(options: argparse.Namespace, scenario: "Scenario", log: "PlayedLog | None") -> None:
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.user_code import code_folders

    run_processes(
        scenario,
        plan_of(scenario),
        options.recording,
        log,
        code_folders(options.code),
        secure=not options.insecure,
        guests=options.keys,
        restarts=options.restarts,
        durable=options.durable,
        resume=True,
    )
