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
from dynpf_lab.references.table import CHECKOUT, Entry, Made, recording_file

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


def parts(entry: Entry) -> tuple[str, ...]:
    """Return the parts of a recording to be checked."""
    if entry.log:
        return (RUN,)
    again = (RUN,) if resolve(entry).clock == "lockstep" else ()
    return (FILE, *entry.nodes, *again)


def check_part(entry: Entry, part: str, checkout: Path = CHECKOUT) -> Finding:
    """Check one of ``parts(entry)``. A part that cannot be read or run is a difference, not an error."""
    try:
        if entry.made is None:
            raise UsageError("not recorded yet; dynpf references update records it")
        if part == FILE:
            return _check_file(entry, entry.made, checkout)
        if part == RUN:
            return _check_run(entry, entry.made, checkout)
        return _check_node(entry, part, checkout)
    except (DynpfError, ProtocolError) as error:
        return Finding(recording=entry.name, part=part, verdict="differs", note=str(error))


def _check_file(entry: Entry, made: Made, checkout: Path) -> Finding:
    recording = _read(entry, checkout)
    found = content_digest(recording)
    if found == made.digest:
        # The table determines the run and its code, as for the nodes.
        scenario = recorded_scenario(recording, allow_code=resolve(entry).user_code)
        findings, first = check_run(recording, scenario)
        if findings:
            note = f"{findings[0].where}: {findings[0].what}"
            return Finding(recording=entry.name, part=FILE, verdict="differs", note=note)
        return _finding(entry, FILE, first)
    text = f"content digest {found}, the table says {made.digest}"
    return Finding(recording=entry.name, part=FILE, verdict="differs", note=text)


def _check_node(entry: Entry, node: str, checkout: Path) -> Finding:
    recording = _read(entry, checkout)
    # The table determines the run and its code: other code that the file names is not executed.
    scenario = recorded_scenario(recording, allow_code=resolve(entry).user_code)
    replayed = replay_node(recording, plan_of(scenario), node)
    if not replayed.messages:
        return Finding(
            recording=entry.name, part=node, verdict="differs", note="sent no messages, so nothing was compared"
        )
    note = explain_different_bytes(recording.header.provenance, collect()) if replayed.mismatch is not None else ""
    return _finding(entry, node, replayed.mismatch, note)


def _check_run(entry: Entry, made: Made, checkout: Path) -> Finding:
    if not has_data(checkout, entry):
        return Finding(recording=entry.name, part=RUN, verdict="skipped", note=f"{entry.log} is not there")
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        rerun = rerun_entry(checkout, entry, Path(folder) / "rerun.mcap")
        digest = content_digest(rerun)
        if digest == made.digest:
            return _finding(entry, RUN, None)
        notes, first = [f"content digest {digest}, the table says {made.digest}"], None
        if not entry.log:
            recorded = _read(entry, checkout)
            first = _first(diff(recorded, rerun))
            notes.append(explain_different_bytes(recorded.header.provenance, rerun.header.provenance))
        note = "; ".join(filter(None, notes))
        return Finding(recording=entry.name, part=RUN, verdict="differs", note=note, first=first)


def _read(entry: Entry, checkout: Path) -> Recording:
    return read_recording(recording_file(checkout, entry))


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
