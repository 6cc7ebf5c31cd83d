"""Runs jobs under a setting in a process of their own, and finds where the outcome differs from another setting's."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dynpf_formats.recording.diff import FirstDifference
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_lab.references.table import CHECKOUT
from dynpf_lab.references.update import first_differences
from dynpf_protocol.topics import NODES

from checks.machines.debian import CACHE
from checks.machines.settings import CHOOSERS, Processor, Setting
from checks.machines.worker import Done, Told

__all__ = ["Difference", "Outcome", "differences", "first_by_node", "processor", "run"]


class Outcome(NamedTuple):
    """What came of the jobs under a setting; ``told`` is None where its process said nothing at all."""

    setting: Setting
    folder: Path  # with a recording of each job
    told: Told | None
    done: Mapping[str, Done]
    failure: str  # how the process ended, if not well
    seconds: float


class Difference(NamedTuple):
    """A job that came out otherwise; ``where`` has the first place of each node, in the order in which they occur."""

    job: str
    where: tuple[FirstDifference, ...]
    note: str


def run(
    setting: Setting, jobs: Sequence[str], folder: Path, show: Callable[[Done, float], None] = lambda *_: None
) -> Outcome:
    """Run jobs under a setting, showing each as it is done with the seconds since the start."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {name: value for name, value in os.environ.items() if name not in CHOOSERS}
    paths = [str(CHECKOUT), *(str(package.parent) for package in sorted(CHECKOUT.glob("*/dynpf_*/")))]
    command: tuple[str, ...] = (sys.executable,)
    if setting.interpreter is not None:
        command = setting.interpreter.command
        paths.append(str(setting.interpreter.packages))
    environment |= {"PYTHONHASHSEED": "0", "PYTHONPATH": os.pathsep.join(paths), "PYTHONNOUSERSITE": "1"}
    if setting.kernels:
        kernels = CACHE / "kernels" / setting.kernels
        kernels.mkdir(parents=True, exist_ok=True)
        environment["NUMBA_CACHE_DIR"] = str(kernels)
    environment |= setting.environment
    start = time.monotonic()
    told: Told | None = None
    done: dict[str, Done] = {}
    with (
        (folder / "stderr.txt").open("w+", encoding="utf-8") as errors,
        subprocess.Popen(
            [*command, "-m", "checks.machines.worker", str(folder), *jobs],
            cwd=CHECKOUT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        ) as process,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            if told is None:
                told = msgspec.json.decode(line, type=Told)
                continue
            one = msgspec.json.decode(line, type=Done)
            done[one.job] = one
            show(one, time.monotonic() - start)
        code = process.wait()
        errors.seek(0)
        last = (errors.read().strip().splitlines() or [""])[-1]
    failure = f"ended with {code}: {last}" if code else ""
    return Outcome(setting, folder, told, done, failure, time.monotonic() - start)


def processor(told: Told) -> Processor:
    """Return what the table of settings asks of the processor that a run was on."""
    marked = [word.rstrip("?") for word in told.opencv_line.split() if word.startswith("*") and not word.endswith("?")]
    return Processor(
        told.machine,
        frozenset(told.features),
        told.numpy_dispatched,
        tuple(word.removeprefix("*") for word in marked),
        told.glibc,
    )


def differences(expected: Outcome, found: Outcome, jobs: Sequence[str]) -> list[Difference]:
    """Return the jobs that came out otherwise than expected, or not at all."""
    different = []
    for job in jobs:
        a, b = expected.done.get(job), found.done.get(job)
        if a is None or b is None:
            different.append(Difference(job, (), found.failure or expected.failure or "not run"))
        elif a.error or b.error:
            different.append(Difference(job, (), b.error or f"expected: {a.error}"))
        elif a != b:
            paths = (outcome.folder / f"{job}.mcap" for outcome in (expected, found))
            different.append(compared(job, *(read_recording(path) for path in paths)))
    return different


def compared(job: str, expected: Recording, found: Recording) -> Difference:
    """Return where two recordings of a job differ."""
    a, b = ({one.name: one.data for one in recording.attachments} for recording in (expected, found))
    attached = sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))
    note = f"attachments: {', '.join(attached)}" if attached else ""
    return Difference(job, first_by_node(first_differences(expected, found)), note)


def first_by_node(all_first: Sequence[FirstDifference]) -> tuple[FirstDifference, ...]:
    """Return the first difference of each node, by tick, then in the order of the nodes in a tick."""
    found: dict[str, FirstDifference] = {}
    for one in sorted(all_first, key=_order):
        found.setdefault(one.node, one)
    return tuple(found.values())


def _order(one: FirstDifference) -> tuple[Any, ...]:
    node = NODES.index(one.node) if one.node in NODES else -1  # the log comes before all nodes
    return (one.tick if one.tick is not None else -1, node, one.topic.startswith("journal/"), one.sequence)
