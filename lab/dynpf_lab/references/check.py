"""Checks reference recordings: the file, a replay of every node from it, and a new run."""

import tempfile
from pathlib import Path
from typing import Literal

import msgspec
from dynpf_formats.recording.diff import Difference, diff
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.provenance import collect, explain_different_bytes
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_protocol.errors import DynpfError, ProtocolError, UsageError
from dynpf_runtime.replay import Mismatch, replay_node
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.replay import check_run

from dynpf_lab.references.runs import has_data, rerun_entry, resolve
from dynpf_lab.references.table import Entry, Made, Table

__all__ = ["FILE", "RUN", "Finding", "check_part", "parts"]

FILE = "file"
RUN = "run"


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """The result of checking a part of a recording: the file, a new run, or a node."""

    recording: str
    part: str
    verdict: Literal["same", "differs", "skipped"]
    note: str = ""
    first: Mismatch | None = None


def parts(table: Table, entry: Entry) -> tuple[str, ...]:
    """Return the parts of a recording to be checked; raises ScenarioError for a scenario that cannot be run."""
    if not entry.kept:
        return (RUN,)
    scenario = resolve(table, entry)
    again = (RUN,) if scenario.clock == "lockstep" else ()
    return (FILE, *(entry.nodes or scenario.nodes), *again)


def check_part(table: Table, entry: Entry, part: str) -> Finding:
    """Check one of ``parts(table, entry)``. A part that cannot be read or run is a difference, not an error."""
    try:
        if entry.made is None:
            raise UsageError("not recorded yet; dynpf references update records it")
        if part == FILE:
            return _check_file(table, entry, entry.made)
        if part == RUN:
            return _check_run(table, entry, entry.made)
        return _check_node(table, entry, part)
    except (DynpfError, ProtocolError) as error:
        return Finding(recording=entry.name, part=part, verdict="differs", note=str(error))


def _check_file(table: Table, entry: Entry, made: Made) -> Finding:
    recording = _read(table, entry)
    found = content_digest(recording)
    if found == made.digest:
        # The table determines the run and its code, as for the nodes.
        scenario = recorded_scenario(recording, allow_code=resolve(table, entry).user_code)
        findings, first = check_run(recording, scenario)
        if findings:
            note = f"{findings[0].where}: {findings[0].what}"
            return Finding(recording=entry.name, part=FILE, verdict="differs", note=note)
        return _finding(entry, FILE, first)
    text = f"content digest {found}, the table says {made.digest}"
    return Finding(recording=entry.name, part=FILE, verdict="differs", note=text)


def _check_node(table: Table, entry: Entry, node: str) -> Finding:
    recording = _read(table, entry)
    # The table determines the run and its code: other code that the file names is not executed.
    scenario = recorded_scenario(recording, allow_code=resolve(table, entry).user_code)
    replayed = replay_node(recording, plan_of(scenario), node)
    if not replayed.messages:
        return Finding(
            recording=entry.name, part=node, verdict="differs", note="sent no messages, so nothing was compared"
        )
    note = explain_different_bytes(recording.header.provenance, collect()) if replayed.mismatch is not None else ""
    return _finding(entry, node, replayed.mismatch, note)


def _check_run(table: Table, entry: Entry, made: Made) -> Finding:
    if not has_data(table, entry):
        return Finding(recording=entry.name, part=RUN, verdict="skipped", note=f"{table.log(entry)} is not there")
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        rerun = rerun_entry(table, entry, Path(folder) / "rerun.mcap")
        digest = content_digest(rerun)
        if digest == made.digest:
            return _finding(entry, RUN, None)
        notes, first = [f"content digest {digest}, the table says {made.digest}"], None
        if entry.kept:
            recorded = _read(table, entry)
            first = _first(diff(recorded, rerun))
            notes.append(explain_different_bytes(recorded.header.provenance, rerun.header.provenance))
        note = "; ".join(filter(None, notes))
        return Finding(recording=entry.name, part=RUN, verdict="differs", note=note, first=first)


def _read(table: Table, entry: Entry) -> Recording:
    return read_recording(table.recording(entry))


def _finding(entry: Entry, part: str, first: Mismatch | None, note: str = "") -> Finding:
    return Finding(
        recording=entry.name, part=part, verdict="same" if first is None else "differs", note=note, first=first
    )


def _first(difference: Difference) -> Mismatch | None:
    """Return the first difference as a mismatch of a replay."""
    first = difference.first
    if first is None:
        return None
    tick = -1 if first.tick is None else first.tick
    return Mismatch(first.node, first.topic, tick, first.sequence, first.field, first.a, first.b)
