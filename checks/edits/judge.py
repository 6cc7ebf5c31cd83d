"""Finds out what notices an edit of a recording: the doctor, the execution again, a signature, or nothing."""

from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from random import Random
from typing import NamedTuple

from dynpf_formats.certificates import Identity
from dynpf_formats.recording.doctor import Severity, examine
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.signature import load_signer, read_signature, sign, signature_file
from dynpf_protocol.errors import DynpfError, ProtocolError
from dynpf_runtime.bus import keys
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.replay import check_run, replay_nodes

from checks.edits.content import Content, resealed, with_seal, write_content
from checks.edits.kinds import Kind

__all__ = ["Found", "Judge", "Judged", "Level"]


class Level(StrEnum):
    """What who edits a file makes right again; each level does what those before it do."""

    CHECKSUMS = "checksums right"
    SEAL = "chain and seal right"
    SIGNED = "of a signed file"  # the signature is kept, removed, or made with the key of somebody else


class Found(StrEnum):
    """What noticed an edit."""

    DOCTOR = "doctor"
    REPLAY = "execution"
    SIGNATURE = "signature"
    TOLD = "told by a warning"
    OTHER = "another recording"  # that of a run with other inputs, which is as genuine
    FREE = "seal only"  # it changes nothing that is computed, and the seal was made right
    SILENT = "SILENT"


class Judged(NamedTuple):
    """The outcome of one edit."""

    kind: Kind
    level: Level
    found: Found


class Judge:
    """Makes edits and finds out what notices them; writes into ``folder``."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "edited.mcap"
        self._trusted = folder / "trusted"
        self._signer = _new_signer(self._trusted)
        self._other = _new_signer(folder / "other")

    def judge(self, kind: Kind, content: Content, random: Random, level: Level) -> Judged | None:
        """Make an edit and return what noticed it, or None if there was nothing to change."""
        changed = _changed(kind, content, random, level)
        if changed is None or changed == content:
            return None
        if level is Level.SIGNED:
            return Judged(kind, level, self._found_by_signature(content, changed, random))
        write_content(changed, self._path)
        return Judged(kind, level, _found(kind, self._path, level))

    def _found_by_signature(self, content: Content, changed: Content, random: Random) -> Found:
        now = datetime.now(UTC)
        write_content(content, self._path)
        sign(self._path, self._signer, now)
        write_content(changed, self._path)
        match random.randrange(3):
            case 0:
                signature_file(self._path).unlink()
            case 1:
                sign(self._path, self._other, now)
        signed = read_signature(self._path, self._trusted / "ca.pem", now)
        return Found.SIGNATURE if signed is None or signed.problem else Found.SILENT


def _new_signer(folder: Path) -> Identity:
    """Return a new recorder's key of a new authority."""
    now = datetime.now(UTC)
    keys.init(folder, now)
    keys.issue(folder, ["recorder"], now)
    return load_signer(folder / "recorder.key", now)


def _changed(kind: Kind, content: Content, random: Random, level: Level) -> Content | None:
    """Return the changed content; an end is changed last, and everything else before it is sealed."""
    if level is Level.CHECKSUMS:
        return kind.change(content, random)
    changed = kind.change(resealed(content) if kind.end else content, random)
    if changed is None:
        return None
    return with_seal(changed) if kind.end else resealed(changed)


def _found(kind: Kind, path: Path, level: Level) -> Found:
    findings = examine(path)
    if any(finding.severity is not Severity.WARNING for finding in findings):
        return Found.DOCTOR
    if findings and kind.what == "not compared":
        return Found.TOLD
    if level is Level.CHECKSUMS:
        return Found.SILENT
    if _differs(path):
        return Found.REPLAY
    if kind.input:
        return Found.OTHER
    return Found.FREE if kind.free else Found.SILENT


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
