"""``dynpf study``: the experiments of the source documents."""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from dynpf_experiments.catalogue import study_names

__all__ = ["add_parser"]


def add_parser(commands: "argparse._SubParsersAction[Any]") -> None:
    parser = commands.add_parser("study", help="an experiment of the source documents: many trials, and what they show")
    parser.add_argument("name", metavar="NAME", help=f"one of {', '.join(study_names())}")
    parser.add_argument("--trials", type=int, metavar="N", help="trials of each setting (default: the study's own)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of everything random (default: 1)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="one setting of the study, such as n=100 or n=[50,100]; may be repeated",
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes; the results are the same (default: all cores)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for rows.json, rows.csv and figures")
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="folder of the logs that studies know by name (default: $DYNPF_DATA)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    import msgspec
    from dynpf_experiments.catalogue import study_named
    from dynpf_experiments.data import FOLDER_VARIABLE
    from dynpf_experiments.rows import as_csv, as_table
    from dynpf_experiments.study import run_study, settings_from
    from dynpf_protocol.errors import UsageError

    study = study_named(options.name)
    if options.data is not None:
        os.environ[FOLDER_VARIABLE] = str(options.data.absolute())  # the study's processes inherit it
    settings = settings_from(study.settings, options.overrides)
    trials = study.trials if options.trials is None else options.trials
    jobs = (os.cpu_count() or 1) if options.jobs is None else options.jobs
    for name, number in (("--trials", trials), ("--jobs", jobs)):
        if number < 1:
            raise UsageError(f"{name} {number}: expected at least 1")
    folder = options.output
    if folder is not None:
        _make(folder)
    rows = run_study(study, settings, trials, options.seed, jobs)
    document = msgspec.json.encode({"study": options.name, "rows": rows})
    print(document.decode() if options.json else as_table(rows, study.columns))
    if folder is not None:
        (folder / "rows.json").write_bytes(document)
        (folder / "rows.csv").write_text(as_csv(rows), encoding="utf-8")
        for path in study.figures(settings, options.seed, rows, folder):
            print(f"dynpf study: {path}", file=sys.stderr)
    return 0


def _make(folder: Path) -> None:
    from dynpf_protocol.errors import UsageError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made: {error.strerror}") from error
