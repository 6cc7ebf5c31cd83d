"""``dynpf sweep``: a scenario with each combination of some settings, many seeds each, and what the runs measure."""

import argparse
import tomllib
from pathlib import Path
from typing import Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.options import add_code
from dynpf_lab.cli.study import add_report_options, report

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser(
        "sweep",
        help="a scenario with each of some settings, over many seeds",
        description="Runs the scenario inline with each combination of settings and each seed, and prints a row for "
        "each combination: mean of each measure over the seeds, and its 95 % interval.",
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file")
    parser.add_argument(
        "--seeds", type=_seeds, default=(1, 10), metavar="FIRST:LAST", help="seeds of the runs (default: 1:10)"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE,...",
        help="the values of one key, such as estimator.n=50,500; may be repeated",
    )
    parser.add_argument(
        "--measure",
        action="append",
        required=True,
        dest="measures",
        metavar="NAME",
        help="one of those that dynpf metrics --json prints, such as position_rmse_m; of one of several estimators "
        "ESTIMATOR.NAME; may be repeated",
    )
    parser.add_argument("--log", type=Path, metavar="IN.mcap", help="imported log that the sensors process plays")
    add_code(parser)
    add_report_options(parser)
    parser.set_defaults(run=run)


def _seeds(text: str) -> tuple[int, int]:
    first, between, last = text.partition(":")
    try:
        found = int(first), int(last if between else first)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: expected FIRST:LAST, such as 1:200") from None
    if found[0] > found[1]:
        raise argparse.ArgumentTypeError(f"{text!r}: expected LAST not below FIRST")
    return found


def values_of(override: str) -> tuple[str, list[Any]]:
    """Return the key and the values of KEY=VALUE,...: as in TOML, or else texts; raises UsageError."""
    key, equals, text = override.partition("=")
    if not equals or not key or not text:
        raise UsageError(f"--set {override}: expected KEY=VALUE,..., such as estimator.n=50,500")
    try:
        return key, tomllib.loads(f"values = [{text}]")["values"]
    except tomllib.TOMLDecodeError:
        return key, text.split(",")


def run(options: argparse.Namespace) -> int:
    from dynpf_experiments.sweep import sweep

    first, last = options.seeds
    study = sweep(
        scenario=options.scenario,
        grid=dict(map(values_of, options.overrides)),
        measures=options.measures,
        log=options.log,
        code=options.code,
    )
    return report(options.scenario, study, study.settings(), options, trials=last - first + 1, seed=first)
