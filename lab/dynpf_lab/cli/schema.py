"""``dynpf schema``: the JSON schema of scenario files, for editors."""

import argparse
import json

__all__ = ["add_arguments"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf schema``."""
    parser.description = (
        "Editors complete and check the keys of a scenario by it: dynpf schema > scenario.schema.json, and "
        "'#:schema scenario.schema.json' as the first line of the scenario."
    )
    parser.set_defaults(run=run)


def run(_options: argparse.Namespace) -> int:
    """Execute ``dynpf schema`` and return its exit code."""
    from dynpf_services.scenario.vocabulary import json_schema

    print(json.dumps(json_schema(), indent=2))
    return 0
