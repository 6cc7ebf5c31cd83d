"""The guard of a run: a small process that ends the run's processes when the one that started them was killed.

Processes notice by themselves that their parent is gone, unless they hang or are held up. The guard waits for a moment,
asks those that are left to end at once, and then kills them.
"""

import contextlib
import os
import select
import shutil
import signal
import time
from collections.abc import Sequence
from pathlib import Path

from setproctitle import setproctitle

from dynpf_runtime.bus.keys import GUESTS, remove_keys

__all__ = ["enlist", "guard"]

END_S = 1.7
"""How long the processes may take to end by themselves."""

CLOSE_S = 0.7
"""How long they may then take to end at once, and the recorder to close its file."""

POLL_S = 0.02
WATCH_S = 0.1

_LIST = "processes"


def guard(parent: int, folder: Path, guests: Path | None = None) -> None:
    """Watch the process ``parent``; when it is gone, end the processes listed in ``folder`` and remove that.

    The keys in the folder ``guests``, which may be a person's own, are of this run alone, and are removed, too. To be
    run in a child of ``parent``, which kills it when all has ended well.
    """
    os.setsid()
    setproctitle(f"dynpf guard {folder}")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
    processes: dict[int, _Process] = {}
    gone = False
    while not gone:
        gone = os.getppid() != parent
        for pid in _listed(folder):
            if pid not in processes:
                processes[pid] = _Process(pid)
        if not gone:
            time.sleep(WATCH_S)
    left = list(processes.values())
    _await(left, END_S)
    _send(left, signal.SIGTERM)
    _await(left, CLOSE_S)
    _send(left, signal.SIGKILL)
    shutil.rmtree(folder, ignore_errors=True)
    if guests is not None:
        with contextlib.suppress(OSError):  # it is gone, or no longer ours
            remove_keys(guests, GUESTS)


def enlist(pid: int, folder: Path) -> None:
    """Add a process to those that the guard of ``folder`` ends."""
    with (folder / _LIST).open("a", encoding="ascii") as file:
        file.write(f"{pid}\n")


def _listed(folder: Path) -> list[int]:
    try:
        return [int(line) for line in (folder / _LIST).read_text("ascii").splitlines()]
    except FileNotFoundError:
        return []


class _Process:
    """A process that is no child of this one, whose id may be given to another process after its end."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._descriptor: int | None = None
        with contextlib.suppress(AttributeError, OSError):  # not on this system, or it has ended
            self._descriptor = os.pidfd_open(pid)

    @property
    def runs(self) -> bool:
        if self._descriptor is not None:
            return not select.select([self._descriptor], [], [], 0)[0]
        return not hasattr(os, "pidfd_open") and _exists(self._pid)

    def send(self, number: int) -> None:
        if self.runs:
            with contextlib.suppress(ProcessLookupError):
                if self._descriptor is not None:
                    signal.pidfd_send_signal(self._descriptor, number)
                else:
                    os.kill(self._pid, number)


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True


def _await(processes: Sequence[_Process], patience_s: float) -> None:
    deadline = time.monotonic() + patience_s
    while any(process.runs for process in processes) and time.monotonic() < deadline:
        time.sleep(POLL_S)


def _send(processes: Sequence[_Process], number: int) -> None:
    for process in processes:
        process.send(number)
