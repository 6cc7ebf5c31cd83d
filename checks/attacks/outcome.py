"""What became of a run that was attacked."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_runtime.bus.access import grants
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario

from checks.attacks.kinds import Kind
from checks.attacks.stranger import attack

__all__ = ["LIMIT_S", "PLAIN", "Fate", "Outcome", "attacked", "undisturbed"]

PLAIN = "plain"
"""How a stranger comes to a bus without encryption; else it comes in a role, with its certificate, or with none."""

LIMIT_S = 45.0
TICKS = 120
SCENARIO = "landmark-room"
_RUN = ["run", SCENARIO, "--set", f"max_ticks={TICKS}", "--set", "rate=20"]


class Fate(Enum):
    """What became of a run."""

    UNTOUCHED = "untouched"  # whole, complete, and the same as inline
    TOLD = "told"  # not complete, and it says so
    STOPPED = "stopped"  # complete, but shorter: somebody's request to stop has counted
    FALSE_ALARM = "false alarm"  # the recording is whole and the same, the exit code says otherwise
    SILENT = "silent"  # complete, but not the same
    UNSAID = "unsaid"  # failed without a word, or with a traceback or control characters
    STALLED = "stalled"


class Outcome(NamedTuple):
    """The fate of a run, how often the stranger has acted, and what the run said at its end."""

    fate: Fate
    acts: int
    text: str
    seconds: float


def undisturbed() -> str:
    """Return the content digest of the run that is attacked, from a run in one process."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        command = [sys.executable, "-m", "dynpf_lab.cli.main", *_RUN, "--runner", "inline", "-o", str(path)]
        subprocess.run(command, check=True, capture_output=True)
        return content_digest(read_recording(path))


def attacked(kind: Kind, role: str, expected: str, *, own: bool = False) -> Outcome:
    """Run once, with a stranger in ``role`` that attacks, and return what became of the run.

    With the certificate of a node it leaves out what that node may say, unless it is to speak in its ``own`` name, too.
    """
    left_out = None if own else grants(plan_of(load_scenario(SCENARIO)).graph).get(role)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, errors, guests = folder / "run.mcap", folder / "stderr", folder / "guests"
        options = ["--insecure"] if role == PLAIN else ["--keys", str(guests)]
        command = [sys.executable, "-m", "dynpf_lab.cli.main", *_RUN, *options, "-o", str(path)]
        began = time.monotonic()
        with errors.open("wb") as stderr:
            run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True)
        until, acts = began + LIMIT_S, 0
        try:
            acts = attack(kind, run, None if role == PLAIN else guests, role, until, own=left_out)
            code = run.wait(max(0.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            return Outcome(Fate.STALLED, acts, errors.read_text(errors="replace"), time.monotonic() - began)
        finally:
            _kill(run)
        text = errors.read_bytes().decode(errors="backslashreplace")
        return Outcome(_fate(path, code, text, expected), acts, text, time.monotonic() - began)


def _fate(path: Path, code: int, text: str, expected: str) -> Fate:
    if "Traceback" in text or not text.replace("\n", "").isprintable() or (code and not text):
        return Fate.UNSAID
    recording = read_recording(path) if path.exists() else None
    end = None if recording is None else recording.end
    if recording is None or end is None or not end.complete:
        return Fate.TOLD if code else Fate.UNSAID
    if content_digest(recording) == expected:
        return Fate.FALSE_ALARM if code else Fate.UNTOUCHED
    return Fate.STOPPED if end.counts.get("journal/simulator", 0) < TICKS else Fate.SILENT


def _kill(run: "subprocess.Popen[bytes]") -> None:
    """End a run that has not ended, with all of its processes."""
    for child in _children(run.pid):
        os.kill(child, signal.SIGKILL)
    run.kill()
    run.wait()


def _children(parent: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
    except OSError:
        return []
