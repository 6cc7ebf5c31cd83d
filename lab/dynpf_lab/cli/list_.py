"""``dynpf list``: the scenarios that come with dynpf."""

import argparse
import json

from dynpf_services.scenario.load import load_scenario, scenario_files

from dynpf_lab.cli.arguments import add_json

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf list``."""
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf list`` and return its exit code."""
    scenarios = {file.stem: load_scenario(file.stem) for file in scenario_files()}
    if options.json:
        rows = [
            {"name": name, "title": scenario.title, "needs_log": scenario.needs_log}
            for name, scenario in scenarios.items()
        ]
        print(json.dumps(rows))
        return 0
    width = max(map(len, scenarios))
    for name, scenario in scenarios.items():
        print(f"{name:<{width}}  {scenario.title}{'  (needs --log)' if scenario.needs_log else ''}")
    return 0
