"""``dynpf import amcl``: a scenario from AMCL's parameters, and what becomes of each."""

import argparse
import json
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import UsageError

if TYPE_CHECKING:
    from dynpf_systems.rooms.amcl.reading import Parameters
    from dynpf_systems.rooms.amcl.scenario import Row

__all__ = ["import_amcl", "read_amcl"]

LARGEST = 2**20
"""Bytes of a file of parameters."""

WIDTH = 120


def import_amcl(options: argparse.Namespace) -> int:
    """Execute ``dynpf import amcl`` and return its exit code."""
    from dynpf_formats.regular_files import readable
    from dynpf_services.scenario.load import load_scenario
    from dynpf_systems.rooms.amcl.scenario import rows_of, scenario_of, toml_of

    output: Path = options.output
    if output.suffix != ".toml":
        raise UsageError(f"{output}: a scenario is a .toml file; name it so with -o")
    parameters = read_amcl(options.source)
    made = toml_of(scenario_of(parameters, readable(options.source.name)))
    try:
        with output.open("x") as stream:
            stream.write(made)
    except FileExistsError as error:
        raise UsageError(f"{output}: the file exists; choose another name") from error
    except OSError as error:
        raise UsageError(f"{output}: cannot be written: {error.strerror}") from error
    load_scenario(str(output))
    rows = rows_of(parameters)
    if options.json:
        taken = [row._asdict() for row in rows]
        print(json.dumps({"scenario": str(output), "source": str(options.source), "parameters": taken}))
    else:
        print("\n".join(_in_words(rows, parameters, options)))
    return 0


def read_amcl(path: Path) -> "Parameters":
    """Return the parameters in a file; raises UsageError, in words, for one that has none or wrong ones."""
    from dynpf_experiments.extras import needing
    from dynpf_formats.regular_files import read_regular

    with needing("yaml", extra="maps", what="reading YAML"):
        from dynpf_systems.rooms.amcl.reading import read_parameters
    try:
        text = read_regular(path, LARGEST).decode()
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text: {error}") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
    if text.lstrip().startswith("<"):
        raise UsageError(f"{path}: XML, such as a launch file; expected YAML (rosparam dump FILE /amcl writes it)")
    try:
        return read_parameters(text, str(path))
    except ValueError as error:
        raise UsageError(str(error)) from error


def _in_words(rows: "Sequence[Row]", parameters: "Parameters", options: argparse.Namespace) -> list[str]:
    from dynpf_systems.rooms.amcl.parameters import is_used

    version = "ROS 1" if parameters.ros1 else "Nav2"
    lines = [f"{options.output}: a scenario of AMCL's parameters in {options.source} ({version})", ""]
    lines += table_of([("parameter", "value", "becomes"), *rows])
    missing = [name for name in parameters.values if name not in parameters.given and is_used(name)]
    text = f"Not in the file, and taken as {version} has them by default: {', '.join(missing) or 'none'}."
    return [*lines, "", *textwrap.wrap(text, WIDTH), f"Run it with: dynpf run {options.output} --log IN.mcap"]


def table_of(rows: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return the lines of a table of three columns, the last one folded."""
    first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
    lines = []
    for name, value, text in rows:
        head, *rest = textwrap.wrap(text, max(WIDTH - first - second - 4, 40))
        lines.append(f"{name:<{first}}  {value:<{second}}  {head}")
        lines += [f"{'':<{first + second + 4}}{line}" for line in rest]
    return lines
