"""Options that several commands share: the scenario, its overrides, its log, and the code that may be run."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_formats.user_classes import MODULE_NAME
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from dynpf_services.scenario.user_code import add_folders, code_folders

from dynpf_lab.cli.arguments import add_log, add_set

if TYPE_CHECKING:
    from dynpf_services.scenario.played_log import PlayedLog

__all__ = ["add_allow_code", "add_code", "add_scenario_options", "load_log", "scenario_from"]


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """Add SCENARIO, --seed, --set and --log."""
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random in the run")
    add_set(parser, "override one key of the scenario, such as estimator.n=500")
    add_log(parser)
    add_code(parser)


def add_code(parser: argparse.ArgumentParser) -> None:
    """Add --code, for commands that run the user's classes."""
    parser.add_argument(
        "--code",
        action="append",
        default=[],
        type=Path,
        metavar="FOLDER",
        help="look for modules of yours in this folder, after installed ones; may be repeated (default: the folder "
        "of the scenario's file)",
    )


def add_allow_code(parser: argparse.ArgumentParser, what: str = "the recording") -> None:
    """Add --allow-code, for commands that run code named by a recording, or by ``what`` else."""
    parser.add_argument(
        "--allow-code",
        action="append",
        default=[],
        type=_module,
        metavar="MODULE",
        help=f"import this module, such as mylab.models, if {what} names a class of it; a recording does not "
        "contain its code, which comes from your Python path; may be repeated (default: no code of yours is run)",
    )


def _module(text: str) -> str:
    if MODULE_NAME.fullmatch(text) is None:
        raise argparse.ArgumentTypeError(f"{text!r}: expected the name of a module, such as mylab.models")
    return text


def load_log(options: argparse.Namespace) -> "PlayedLog | None":
    """Return the log named on the command line, or None."""
    from dynpf_services.scenario.played_log import PlayedLog

    return PlayedLog(options.log) if options.log is not None else None


def scenario_from(options: argparse.Namespace, log: "PlayedLog | None") -> Scenario:
    """Return the resolved scenario that the command line describes; raises ScenarioError."""
    add_folders(code_folders(options.code, options.scenario))
    return load_scenario(
        options.scenario,
        overrides=options.overrides,
        seed=options.seed,
        clock=getattr(options, "clock", None),
        log=log.facts if log else None,
    )
