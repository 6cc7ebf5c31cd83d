"""``dynpf sim``: simulate the processes of a run under schedules of faults."""

import argparse
import json
import os
import sys
import time
from typing import TYPE_CHECKING, Any

from dynpf_lab.cli.arguments import add_clock, add_durable, add_json, add_log, add_set, positive_count
from dynpf_lab.cli.loading import loading
from dynpf_lab.cli.options import add_code, load_log

if TYPE_CHECKING:
    from dynpf_runtime.simulation.campaign import Campaign, Verdict

__all__ = ["add_arguments"]

_MOST_FAILURES = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf sim``."""
    parser.description = (
        "Simulates router, recorder, nodes and their supervision in one process, on a network, clocks and a disk of "
        "its own, under seeded schedules of faults, and checks after each that the run is as if undisturbed, or that "
        "everybody knows what it lacks. A failing schedule is shrunk to the fewest faults and told as a timeline."
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file")
    add_set(parser, "override one key of the scenario, such as max_ticks=40")
    add_log(parser)
    add_code(parser)
    add_clock(parser)
    add_durable(parser)
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="seed of the schedules (default: 1)")
    parser.add_argument(
        "--schedules", type=positive_count, default=200, metavar="N", help="how many schedules to play (default: 200)"
    )
    parser.add_argument(
        "--schedule", type=int, metavar="K", help="play the schedule with this number, and tell its story"
    )
    parser.add_argument(
        "--faults", type=_indices, metavar="I,J", help="only these faults of the schedule, as a failure names them"
    )
    parser.add_argument(
        "--jobs",
        type=positive_count,
        metavar="N",
        help="number of processes, without effect on the results (default: all cores)",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def _indices(text: str) -> list[int]:
    parts = [part.strip() for part in text.split(",")] if text else []
    if not all(part.isdecimal() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r}: expected numbers of faults, such as 0,3")
    return [int(part) for part in parts]


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf sim`` and return its exit code."""
    from dynpf_protocol.errors import UsageError
    from dynpf_services.scenario.load import load_scenario
    from dynpf_services.scenario.record import check_log
    from dynpf_services.scenario.simulate import campaign_of
    from dynpf_services.scenario.user_code import add_folders, code_folders

    if options.faults is not None and options.schedule is None:
        raise UsageError("--faults chooses among those of one schedule: name it with --schedule K")
    with loading():
        log = load_log(options)
        add_folders(code_folders(options.code, options.scenario))
        scenario = load_scenario(
            options.scenario, overrides=options.overrides, clock=options.clock, log=log.facts if log else None
        )
    check_log(scenario, options.log)
    with campaign_of(scenario, options.seed, log, durable=options.durable) as campaign:
        if options.schedule is not None:
            return _tell(campaign, options.schedule, options.faults)
        return _play(campaign, options)


def _tell(campaign: "Campaign", number: int, only: list[int] | None) -> int:
    """Play one schedule and print its story."""
    from dynpf_protocol.errors import UsageError
    from dynpf_runtime.simulation.timeline import timeline

    count = len(campaign.schedule(number).faults)
    if only is not None and not all(index < count for index in only):
        raise UsageError(f"--faults {','.join(map(str, only))}: schedule {number} has {count} faults, from 0")
    schedule = campaign.schedule(number, only)
    verdict, trial = campaign.judge(schedule, replay=True)
    print(schedule)
    for line in timeline(trial, campaign.source):
        print(line)
    print(_outcome(verdict))
    return 1 if verdict.broken else 0


def _outcome(verdict: "Verdict") -> str:
    if verdict.broken:
        return "BROKEN: " + "; ".join(verdict.broken)
    return "the run is whole" if verdict.whole else "the run is incomplete, and that is known"


def _play(campaign: "Campaign", options: argparse.Namespace) -> int:
    """Play all schedules; print how many runs were whole, and the story of those that break an invariant."""
    from dynpf_runtime.progress import Share

    jobs = options.jobs or os.cpu_count() or 1
    began_s = time.monotonic()
    played, whole = 0, 0
    failures: list[Verdict] = []
    with Share(options.schedules, "schedules") as progress:
        for verdict in campaign.verdicts(range(options.schedules), jobs):
            played += 1
            whole += verdict.whole
            if verdict.broken:
                failures.append(verdict)
            progress.show(played, f", {len(failures)} broken")
    failures.sort(key=lambda verdict: verdict.number)
    took_s = time.monotonic() - began_s
    if options.json:
        print(json.dumps(_document(campaign, options, failures, played=played, whole=whole)))
        return 1 if failures else 0
    for failure in failures[:_MOST_FAILURES]:
        print(f"schedule {failure.number} breaks: {'; '.join(failure.broken)}")
        only = campaign.shrink(failure.number)
        print(f"again: {_command(options, failure.number, only)}")
        _tell(campaign, failure.number, only)
    if len(failures) > _MOST_FAILURES:
        print(f"and schedules {', '.join(str(failure.number) for failure in failures[_MOST_FAILURES:])}")
    print(
        f"{played} schedules: {whole} runs whole, {played - whole} incomplete and known to be, {len(failures)} broken"
    )
    print(f"dynpf sim: {took_s:.1f} s, {1000 * _busy_s() / played:.0f} ms of a processor a schedule", file=sys.stderr)
    return 1 if failures else 0


def _busy_s() -> float:
    """Return for how long this process and those that it has waited for have used a processor."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _document(
    campaign: "Campaign", options: argparse.Namespace, failures: list["Verdict"], *, played: int, whole: int
) -> dict[str, Any]:
    broken = []
    for failure in failures[:_MOST_FAILURES]:
        only = campaign.shrink(failure.number)
        again = _command(options, failure.number, only)
        broken.append({"schedule": failure.number, "broken": failure.broken, "faults": only, "again": again})
    return {"schedules": played, "whole": whole, "failures": len(failures), "broken": broken}


def _command(options: argparse.Namespace, number: int, only: list[int]) -> str:
    """Return the command that plays a schedule again."""
    words = ["dynpf sim", options.scenario, *(f"--set {override}" for override in options.overrides)]
    words += [f"--clock {options.clock}"] if options.clock else []
    words += ["--durable"] if options.durable else []
    words += [f"--log {options.log}"] if options.log else []
    words += [f"--code {folder}" for folder in options.code]
    return " ".join([*words, f"--seed {options.seed} --schedule {number} --faults {','.join(map(str, only))}"])
