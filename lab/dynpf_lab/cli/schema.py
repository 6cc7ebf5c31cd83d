"""``dynpf schema``: the JSON schema of scenario files, for editors."""

import argparse
import json
from typing import Any

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser(
        "schema",
        help="print the JSON schema of scenario files",
        description="Editors complete and check the keys of a scenario by it: dynpf schema > scenario.schema.json, and "
        "'#:schema scenario.schema.json' as the first line of the scenario.",
    )
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace) -> int:
    from dynpf_services.scenario.vocabulary import json_schema

    print(json.dumps(json_schema(), indent=2))
    return 0
