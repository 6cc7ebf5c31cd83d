"""``dynpf list``: the scenarios that come with dynpf."""

import argparse
import json
from typing import Any

from dynpf_services.scenario.load import load_scenario, scenario_files

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("list", help="scenarios, one line each")
    parser.add_argument("--json", action="store_true")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    scenarios = {file.stem: load_scenario(file.stem) for file in scenario_files()}
    if options.json:
        rows = [{"name": name, "title": one.title, "needs_log": one.needs_log} for name, one in scenarios.items()]
        print(json.dumps(rows))
        return 0
    width = max(map(len, scenarios))
    for name, one in scenarios.items():
        print(f"{name:<{width}}  {one.title}{'  (needs --log)' if one.needs_log else ''}")
    return 0
