"""Executes the runs of the table's rows again, each into a recording."""

import tempfile
from contextlib import chdir
from pathlib import Path

from dynpf_formats.importers.mrclam import import_mrclam
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.errors import RunError, UsageError
from dynpf_runtime.bus.processes import run_on_bus
from dynpf_runtime.bus.terminal import StopSignal
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import check_log, record_inline
from dynpf_services.scenario.schema import Scenario, whole_json
from dynpf_services.scenario.user_code import add_folders, check_allowed, code_folders

from dynpf_lab.cli.main import main
from dynpf_lab.references.table import Entry, Table

__all__ = ["find_code", "has_data", "rerun_entry", "resolve"]


def find_code(table: Table) -> None:
    """Have the modules that the table may run be found in its folders and beside its scenarios.

    Raises UsageError if a module that is allowed lies in two of the folders: only one of them would be run.
    """
    folders: dict[Path, None] = {}
    for entry in table.rows:
        found = code_folders(table.code, table.scenario(entry))
        folders.update({folder.resolve(): None for folder in found})
    for module in sorted(table.allow_code):
        top = module.partition(".")[0]
        places = [folder for folder in folders if (folder / f"{top}.py").is_file() or (folder / top).is_dir()]
        if len(places) > 1:
            raise UsageError(f"{table.path}: the module {top} is in {places[0]} and in {places[1]}: rename one of them")
    add_folders(folders)


def resolve(table: Table, entry: Entry, log: PlayedLog | None = None) -> Scenario:
    """Return the scenario of a row by the current code.

    Raises ScenarioError for an invalid one, and for one that names code that is not allowed.
    """
    facts = log.facts if log is not None else None
    name = table.scenario(entry)
    with chdir(table.path.parent):  # paths of overrides are relative to the table, too
        scenario = load_scenario(
            name, overrides=entry.overrides, seed=entry.seed, log=facts, allow_code=table.allow_code
        )
    check_allowed(scenario.user_classes, scenario.user_code, f"{table.path}: {entry.name}", "a table of references")
    return scenario


def has_data(table: Table, entry: Entry) -> bool:
    """Return whether the log of the run is present; True for a run without a log."""
    return not entry.log or table.log(entry).exists()


def rerun_entry(table: Table, entry: Entry, path: Path) -> Recording:
    """Record the run of a row into ``path``: inline, or over the bus if its clock is realtime.

    Raises RunError if the run is incomplete, UsageError for a realtime run whose recording is not kept.
    """
    log = _log(table.log(entry)) if entry.log else None
    scenario = resolve(table, entry, log)
    check_log(scenario, table.log(entry) if entry.log else None)
    if scenario.clock == "realtime":
        if not entry.kept:
            raise UsageError(
                f"{entry.name}: a realtime run is never the same twice, so its recording has to be kept, and it plays "
                "no log"
            )
        code = code_folders(table.code, table.scenario(entry))
        with StopSignal.installed() as stop:
            run_on_bus(main, plan_of(scenario).graph.nodes, whole_json(scenario), path, stop=stop, code=code)
    else:
        record_inline(scenario, path, log)
    recording = read_recording(path)
    if recording.end is None or not recording.end.complete:
        raise RunError(f"{entry.name}: the run is incomplete: {recording.end.reason if recording.end else 'no end'}")
    return recording


def _log(path: Path) -> PlayedLog:
    if path.is_file():
        return PlayedLog(path)
    with tempfile.TemporaryDirectory(prefix="dynpf-") as temporary:
        imported = Path(temporary) / "log.mcap"
        write_recording(import_mrclam(path), imported)
        return PlayedLog(imported)
