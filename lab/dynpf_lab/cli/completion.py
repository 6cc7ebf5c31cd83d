"""Tab completion of the shell's line, by argcomplete."""

import argparse
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import argcomplete
from argcomplete.completers import BaseCompleter, FilesCompleter

__all__ = ["complete"]


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the completions for the shell that requests them, and exit."""
    argcomplete.autocomplete(parser, default_completer=_Values())


class _Values(BaseCompleter):
    """Completes arguments without a list of choices."""

    def __call__(self, *, action: argparse.Action, parser: argparse.ArgumentParser, **asked: Any) -> Iterable[str]:
        metavar = str(action.metavar)
        if metavar == "SCENARIO":
            shipped = (Path(file.name) for file in files("dynpf_scenarios").iterdir())
            names = sorted(file.stem for file in shipped if file.suffix == ".toml")
            return [*names, *FilesCompleter(["toml"])(**asked)]
        if parser.prog == "dynpf study" and metavar == "NAME":
            from dynpf_experiments.catalogue import study_names

            return study_names()
        return FilesCompleter(["mcap"] if metavar.endswith(".mcap") else ())(**asked)
