"""Runs jobs in this process, whatever processor it is on: ``python -m checks.machines.worker FOLDER JOB...``.

Prints one JSON document a line: first the processor and the controls, then what came of each job. Recordings are left
in the folder.
"""

import hashlib
import platform
import sys
from pathlib import Path

import cv2
import msgspec
import numpy as np
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording

from checks.machines.controls import control_digests
from checks.machines.jobs import JOBS, run_job

__all__ = ["Done", "Told", "outcome_digest"]


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """What the process says of itself."""

    machine: str
    python: str
    glibc: bool
    features: tuple[str, ...]  # of the processor, by the names of Linux
    numpy_dispatched: tuple[str, ...]
    opencv_line: str
    controls: dict[str, str]


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a job: a digest, or why there is none."""

    job: str
    digest: str = ""
    absent: bool = False  # the log that it plays
    error: str = ""


def outcome_digest(path: Path) -> str:
    """Return the digest of all that is compared of a recording, and of what is attached to it."""
    recording = read_recording(path)
    total = hashlib.sha256(content_digest(recording).encode())
    for one in sorted(recording.attachments, key=lambda one: one.name):
        total.update(f"{one.name} {len(one.data)}\n".encode() + one.data)
    return total.hexdigest()


def _told() -> Told:
    return Told(
        machine=platform.machine(),
        python=platform.python_version(),
        glibc=platform.libc_ver()[0] == "glibc",
        features=_features(),
        numpy_dispatched=tuple(np.show_config(mode="dicts")["SIMD Extensions"].get("found", ())),
        opencv_line=cv2.getCPUFeaturesLine(),
        controls=control_digests(),
    )


def _features() -> tuple[str, ...]:
    """Return what Linux says of the processor's instructions; it is silent in emulation."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    found = [line.partition(":")[2] for line in lines if line.startswith(("flags", "Features"))]
    return tuple(found[0].split()) if found else ()


def _done(name: str, folder: Path) -> Done:
    (job,) = [job for job in JOBS if job.name == name]
    try:
        path = run_job(job, folder)
        return Done(job=name, absent=True) if path is None else Done(job=name, digest=outcome_digest(path))
    except Exception as error:  # on another processor anything may go wrong, and the other jobs shall still be run
        return Done(job=name, error=f"{type(error).__name__}: {error}")


def main() -> None:
    folder = Path(sys.argv[1])
    _say(_told())
    for name in sys.argv[2:]:
        _say(_done(name, folder))


def _say(told: msgspec.Struct) -> None:
    print(msgspec.json.encode(told).decode(), flush=True)


if __name__ == "__main__":
    main()
