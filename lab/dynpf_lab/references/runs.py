"""Executes the runs of the table's rows again, each into a recording."""

import tempfile
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
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.schema import Scenario, whole_json

from dynpf_lab.cli.main import main
from dynpf_lab.references.table import Entry

__all__ = ["has_data", "rerun_entry", "resolve"]


def resolve(entry: Entry, log: PlayedLog | None = None) -> Scenario:
    """Return the scenario of a row by the current code."""
    return load_scenario(
        entry.scenario, overrides=entry.overrides, seed=entry.seed, log=log.facts if log is not None else None
    )


def has_data(checkout: Path, entry: Entry) -> bool:
    """Return whether the log of the run is present; True for a run without a log."""
    return not entry.log or (checkout / entry.log).is_dir()


def rerun_entry(checkout: Path, entry: Entry, path: Path) -> Recording:
    """Record the run of a row into ``path``: inline, or over the bus if its clock is realtime.

    Raises RunError if the run is incomplete.
    """
    log = _import(checkout / entry.log) if entry.log else None
    scenario = resolve(entry, log)
    if scenario.clock == "realtime":
        if log is not None:
            raise UsageError(f"{entry.name}: a realtime run that plays a log cannot be a reference")
        with StopSignal.installed() as stop:
            run_on_bus(main, plan_of(scenario).graph.nodes, whole_json(scenario), path, stop=stop)
    else:
        record_inline(scenario, path, log)
    recording = read_recording(path)
    if recording.end is None or not recording.end.complete:
        raise RunError(f"{entry.name}: the run is incomplete: {recording.end.reason if recording.end else 'no end'}")
    return recording


def _import(folder: Path) -> PlayedLog:
    with tempfile.TemporaryDirectory(prefix="dynpf-") as temporary:
        path = Path(temporary) / "log.mcap"
        write_recording(import_mrclam(folder), path)
        return PlayedLog(path)
