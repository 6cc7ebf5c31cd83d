"""``dynpf study``: the experiments of the source documents."""

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_experiments.catalogue import study_names

from dynpf_lab.cli.arguments import add_json, add_set
from dynpf_lab.cli.page import add_no_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    import msgspec
    from dynpf_experiments.rows import Row
    from dynpf_experiments.study import Study

    from dynpf_lab.page.study import Told

__all__ = ["add_arguments", "add_report_options", "report"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf study``."""
    parser.add_argument(
        "name", metavar="NAME", help=f"one of {', '.join(study_names())}; or a Python file with a STUDY"
    )
    parser.add_argument("--trials", type=int, metavar="N", help="trials of each setting (default: the study's own)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of everything random (default: 1)")
    add_set(parser, "one setting of the study, such as n=100 or n=[50,100]")
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="folder of the logs that studies know by name (default: $DYNPF_DATA)"
    )
    add_report_options(parser)
    parser.set_defaults(run=run)


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Add --jobs, --json and --output."""
    parser.set_defaults(prog=parser.prog)
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="number of processes, without effect on the results (default: all cores)"
    )
    add_json(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="folder for rows.json, rows.csv, figures, and index.html that shows them",
    )
    add_no_page(parser, "make no page (index.html in the folder)")


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf study`` and return its exit code."""
    from dynpf_experiments.catalogue import study_named
    from dynpf_experiments.data import FOLDER_VARIABLE
    from dynpf_experiments.study import settings_from
    from dynpf_protocol.errors import UsageError

    study = study_named(options.name)
    if options.data is not None:
        os.environ[FOLDER_VARIABLE] = str(options.data.absolute())  # the study's processes inherit it
    settings = settings_from(study.settings, options.overrides)
    trials = study.trials if options.trials is None else options.trials
    if trials < 1:
        raise UsageError(f"--trials {trials}: expected at least 1")
    return report(options.name, study, settings, options, trials=trials, seed=options.seed)


def report(
    name: str, study: "Study", settings: "msgspec.Struct", options: argparse.Namespace, *, trials: int, seed: int
) -> int:
    """Execute a study and print or write its rows, depending on the options."""
    import msgspec
    from dynpf_experiments.rows import as_csv, as_table, columns_of
    from dynpf_experiments.study import run_study
    from dynpf_protocol.errors import UsageError

    from dynpf_lab.page.study import Told

    asked = {key: value for key, value in msgspec.to_builtins(settings).items() if not isinstance(value, dict)}
    jobs = (os.cpu_count() or 1) if options.jobs is None else options.jobs
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: expected at least 1")
    folder = options.output
    if folder is not None:
        _make(folder)
    rows = run_study(study, settings, trials, seed, jobs)
    document = msgspec.json.encode({"study": name, "rows": rows})
    print(document.decode() if options.json else as_table(rows, study.columns or columns_of(rows)))
    if folder is not None:
        (folder / "rows.json").write_bytes(document)
        (folder / "rows.csv").write_text(as_csv(rows), encoding="utf-8")
        try:
            figures = study.figures(settings, seed, rows, folder)
        except UsageError as error:  # rows do not need what draws figures
            print(f"{options.prog}: no figures: {error}", file=sys.stderr)
            figures = []
        page = (
            []
            if options.no_page
            else [_page(folder, Told(name, study.about, _said(), asked, trials, seed), rows, figures)]
        )
        for path in (*figures, *page):
            print(f"{options.prog}: {path}", file=sys.stderr)
    return 0


def _page(folder: Path, told: "Told", rows: "Sequence[Row]", figures: "Sequence[Path]") -> Path:
    """Write the page of a study and return its path."""
    from dynpf_lab.page.study import study_page

    path = folder / "index.html"
    path.write_text(study_page(told, rows, figures), encoding="utf-8")
    return path


def _said() -> str:
    """Return the command as it was given."""
    return shlex.join(["dynpf", *sys.argv[1:]])


def _make(folder: Path) -> None:
    from dynpf_protocol.errors import UsageError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}") from error
