"""What is run on every machine: every reference recording executed again, and a short run of each system."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.importers.mrclam import import_mrclam
from dynpf_formats.importers.recording import write_recording
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.references.runs import has_data, rerun_entry
from dynpf_lab.references.table import CHECKOUT, Entry, Table, read_table
from dynpf_runtime.replay import replay_node, write_replayed
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from dynpf_services.scenario.record import record_inline
from dynpf_services.scenario.recorded import recorded_scenario

__all__ = ["JOBS", "LOGS", "REFERENCE", "Job", "chosen", "run_job"]

REFERENCE = "reference-"

LOGS = {
    "mrclam": "../shared/data/mrclam/ds1_seed_60s",
    "carmen": "../shared/data/carmen/intel_30-150s.log",
}
"""The logs of real robots that runs play, seen from the checkout."""


class Job(NamedTuple):
    """A run in one process; a job without scenario executes the nodes of the reference recording of its name again."""

    name: str
    scenario: str = ""
    overrides: tuple[str, ...] = ()
    log: str = ""  # of LOGS


_RUNS = (
    Job("parts-camera", "parts-3-easy", ("max_ticks=120",)),
    Job("parts-lens", "parts-3-lens", ("max_ticks=50",)),
    Job("parts-disturbed", "parts-3-disturbed", ("max_ticks=600",)),
    Job("parts-extended", "parts-3-tracked", ("max_ticks=200", "estimator.filter=extended_kalman")),
    Job("parts-unscented", "parts-3-tracked", ("max_ticks=200", "estimator.filter=unscented_kalman")),
    Job("colon-hypotheses", "colon-case-3", ()),
    Job("colon-own-maps", "colon-own-maps", ()),
    Job("colon-growth", "colon-growth", ()),
    Job("landmarks", "landmark-room", ("max_ticks=600",)),
    Job(
        "landmarks-threads",
        "landmark-room",
        ("max_ticks=40", "estimator.n=20000", "estimator.filter={kind='sir', threads=2}"),
    ),
    Job("landmarks-extended", "landmark-room", ("max_ticks=150", "estimator.filter=extended_kalman")),
    Job("landmarks-unscented", "landmark-room", ("max_ticks=150", "estimator.filter=unscented_kalman")),
    # It is told a start across the map, notices that it is lost, and searches.
    Job(
        "laser-search-jump",
        "laser-log",
        ("estimator.start={kind='known', x=0.0, y=0.0, theta=3.0}",),
        "carmen",
    ),
    Job("scans", "room-scan", ("max_ticks=300",)),
    Job("lines-camera", "turtlebot-loops", ("max_ticks=300",)),
    Job("lines", "room-lines", ("max_ticks=200",)),
    Job("beams", "indoor-global", ("max_ticks=150",)),
)

JOBS = (*(Job(REFERENCE + entry.name) for entry in read_table().rows), *_RUNS)


def chosen(words: Sequence[str]) -> list[Job]:
    """Return the jobs whose names begin with one of ``words``, all if there is none; raises ValueError."""
    unknown = [word for word in words if not any(job.name.startswith(word) for job in JOBS)]
    if unknown:
        raise ValueError(f"no job begins with {', '.join(unknown)}; jobs: {', '.join(job.name for job in JOBS)}")
    return [job for job in JOBS if not words or job.name.startswith(tuple(words))]


def run_job(job: Job, folder: Path) -> Path | None:
    """Run a job into a recording in ``folder`` and return its path, or None where the log that it plays is absent."""
    path = folder / f"{job.name}.mcap"
    path.unlink(missing_ok=True)
    if not job.scenario:
        table = read_table()
        name = job.name.removeprefix(REFERENCE)
        return _execute_again(table, next(entry for entry in table.rows if entry.name == name), path)
    if job.log and not (CHECKOUT / LOGS[job.log]).exists():
        return None
    log = _imported(job.log, folder) if job.log else None
    scenario = load_scenario(job.scenario, overrides=job.overrides, seed=1, log=log.facts if log else None)
    record_inline(scenario, path, log)
    return path


def _execute_again(table: Table, entry: Entry, path: Path) -> Path | None:
    """Write the reference recording with the output of its nodes, each fed what it consumed, in its own place."""
    if not entry.kept:
        if not has_data(table, entry):
            return None
        rerun_entry(table, entry, path)
        return path
    recording = read_recording(table.recording(entry))
    scenario = recorded_scenario(recording)
    plan = plan_of(scenario)
    outcomes = [replay_node(recording, plan, node, keep=True) for node in entry.nodes]
    with RecordingWriter(path, recording.header, recording.attachments) as writer:
        write_replayed(recording, outcomes, writer)
        writer.close(complete=True, reason="replayed")
    return path


def _imported(name: str, folder: Path) -> PlayedLog:
    """Import a log anew: what its importer computes is part of what has to be the same."""
    source, path = CHECKOUT / LOGS[name], folder / f"log-{name}.mcap"
    path.unlink(missing_ok=True)
    if name == "mrclam":
        write_recording(import_mrclam(source), path)
    else:
        drawn = drawn_map(lambda: import_carmen(source).records, 0.05, "map")
        write_recording(import_carmen(source, attachments=drawn), path)
    return PlayedLog(path)
