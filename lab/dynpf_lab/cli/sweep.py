"""``dynpf sweep``: measures of a scenario with each combination of settings, over many seeds."""

import argparse
import tomllib
from typing import Any

from dynpf_protocol.errors import UsageError

from dynpf_lab.cli.arguments import add_log, add_set
from dynpf_lab.cli.options import add_code
from dynpf_lab.cli.study import add_report_options, report

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf sweep``."""
    parser.description = (
        "Runs the scenario inline with each combination of settings and each seed, and prints a row for "
        "each combination: mean of each measure over the seeds, and its 95 % interval."
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file")
    parser.add_argument(
        "--seeds", type=_seeds, default=(1, 10), metavar="FIRST:LAST", help="seeds of the runs (default: 1:10)"
    )
    add_set(parser, "the values of one key, such as estimator.n=50,500", "KEY=VALUE,...")
    parser.add_argument(
        "--measure",
        action="append",
        required=True,
        dest="measures",
        metavar="NAME",
        help="a measure that dynpf metrics --json prints, such as position_rmse_m; with several estimators "
        "ESTIMATOR.NAME; may be repeated",
    )
    add_log(parser)
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
    """Return key and values of KEY=VALUE,..., in TOML or else strings; raises UsageError."""
    key, equals, text = override.partition("=")
    if not equals or not key or not text:
        raise UsageError(f"--set {override}: expected KEY=VALUE,..., such as estimator.n=50,500")
    if key == "seed":
        raise UsageError(f"--set {override}: seeds are chosen by --seeds FIRST:LAST, such as --seeds 1:200")
    try:
        return key, tomllib.loads(f"values = [{text}]")["values"]
    except tomllib.TOMLDecodeError:
        return key, text.split(",")


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf sweep`` and return its exit code."""
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
