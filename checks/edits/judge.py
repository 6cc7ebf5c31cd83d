"""Finds out what notices an edit of a recording: the doctor, the execution again, a signature, or nothing."""

from enum import StrEnum
from pathlib import Path
from random import Random
from typing import NamedTuple

from dynpf_formats.recording.doctor import Severity, examine
from dynpf_formats.recording.reader import read_recording
from dynpf_protocol.errors import DynpfError, ProtocolError
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.replay import check_run, replay_nodes

from checks.edits.content import Content, resealed, write_content
from checks.edits.kinds import Kind

__all__ = ["Found", "Judged", "judge"]


class Found(StrEnum):
    """What noticed an edit."""

    DOCTOR = "doctor"
    REPLAY = "execution"
    TOLD = "told by a warning"
    OTHER = "another recording"  # that of a run with other inputs, which is as genuine
    FREE = "seal only"  # it changes nothing that is computed, and the seal was made right
    SILENT = "SILENT"


class Judged(NamedTuple):
    """The outcome of one edit."""

    kind: Kind
    resealed: bool
    found: Found


def judge(kind: Kind, content: Content, random: Random, path: Path, *, reseal: bool) -> Judged | None:
    """Make an edit and return what noticed it, or None if there was nothing to change.

    ``reseal``: chain and seal are made right, too; else only the checksums of the file and of its metadata are.
    """
    if kind.end:
        changed = kind.change(resealed(content) if reseal else content, random)
    else:
        changed = kind.change(content, random)
        changed = resealed(changed) if changed is not None and reseal else changed
    if changed is None or changed == content:
        return None
    write_content(changed, path)
    return Judged(kind, reseal, _found(kind, path, reseal=reseal))


def _found(kind: Kind, path: Path, *, reseal: bool) -> Found:
    findings = examine(path)
    if any(finding.severity is not Severity.WARNING for finding in findings):
        return Found.DOCTOR
    if findings:
        return Found.TOLD
    if (reseal or kind.end) and _differs(path):
        return Found.REPLAY
    if (reseal or kind.end) and kind.input:
        return Found.OTHER
    return Found.FREE if (reseal or kind.end) and kind.free else Found.SILENT


def _differs(path: Path) -> bool:
    """Return whether executing the run again shows a difference, or cannot be done."""
    try:
        recording = read_recording(path)
        scenario = recorded_scenario(recording)
        findings, first = check_run(recording, scenario)
        outcomes = replay_nodes(recording, scenario, None, keep=False)
    except (DynpfError, ProtocolError):
        return True
    return bool(findings) or first is not None or any(outcome.mismatch is not None for outcome in outcomes)
