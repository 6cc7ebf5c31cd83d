"""The bus runner: one process a node, over Zenoh; starts them, watches them, and leaves none behind."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from dynpf_protocol.errors import BROKEN_OFF, RunError

from dynpf_runtime.bus.terminal import StopSignal, say

__all__ = ["free_port", "run_on_bus"]

GRACE_S = 2.5
"""How long the others may take to stop by themselves after one process has failed."""

HANG_S = 5.0
"""How long nobody may have ended, while all that ended did so for another's sake, before those left are said to hang.

On a busy machine processes notice at very different times that their run has broken off.
"""

CLOSE_S = 1.0
"""How long the recorder may take to close its file when everybody else has been killed."""

POLL_S = 0.02


def run_on_bus(
    names: Sequence[str], scenario: str, path: Path, log: Path | None, stop: StopSignal, *, code: Sequence[Path] = ()
) -> None:
    """Run the nodes ``names`` of a scenario, given as the text that its processes read, and record it into ``path``.

    ``code`` are the folders in which the processes look for modules of the user's.
    Raises RunError that names the process which failed first; by then every process has ended.
    """
    with tempfile.TemporaryDirectory(prefix="dynpf-") as folder:
        resolved = Path(folder) / "scenario.json"
        resolved.write_text(scenario, encoding="utf-8")
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        with _processes(names, resolved, endpoint, path, log, code=code) as processes:
            _watch(processes, stop)


@contextlib.contextmanager
def _processes(
    names: Sequence[str], resolved: Path, endpoint: str, path: Path, log: Path | None, *, code: Sequence[Path]
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in ("router", "recorder", *names):
            command = [sys.executable, "-P", "-m", "dynpf_lab.cli.main", "service", name, str(resolved)]
            command += ["--listen" if name == "router" else "--connect", endpoint]
            command += ["--quiet", "--parent", str(os.getpid())]
            for folder in code:
                command += ["--code", str(folder.absolute())]
            if log is not None and name != "router":
                command += ["--log", str(log)]
            if name == "recorder":
                command += ["-o", str(path)]
            # A session of its own: Ctrl-C reaches only us, and we ask the run to end in good order.
            processes[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        yield processes
    finally:
        _end(processes)


def _end(processes: dict[str, subprocess.Popen[bytes]]) -> None:
    """Kill what still runs, the recorder and its router last: it is asked to close its file."""
    for name, process in processes.items():
        if name not in {"router", "recorder"}:
            process.kill()
    if "recorder" in processes:
        processes["recorder"].terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            processes["recorder"].wait(CLOSE_S)
    for process in processes.values():
        process.kill()  # does nothing to those that have ended
        process.wait()


def _watch(processes: dict[str, subprocess.Popen[bytes]], stop: StopSignal) -> None:
    failed = ""
    deadline: float | None = None
    asked = False
    left = len(processes)
    while running := [name for name, process in processes.items() if process.poll() is None]:
        if not stop.requested:
            before, failed = failed, failed or _failure(processes)
            if failed and not before:
                deadline = time.monotonic() + GRACE_S
            elif not failed and len(running) < left and any(process.poll() for process in processes.values()):
                deadline = time.monotonic() + HANG_S
            left = len(running)
        if stop.requested and not asked:
            asked = True
            say("run", f"{stop.reason}: ending the run (again to end it at once)")
            for name in running:
                processes[name].terminate()
            deadline = deadline or time.monotonic() + 10.0
        if (deadline is not None or stop.requested) and running == ["router"]:
            processes["router"].terminate()  # it waits for a run that will not come
        if stop.at_once or (deadline is not None and time.monotonic() > deadline):
            names = ", ".join(running)
            raise RunError(f"{failed or stop.reason or f'{names} hangs'}; killed what was left: {names}")
        time.sleep(POLL_S)
    if stop.requested:
        if processes["recorder"].returncode != 0:
            raise RunError(f"{stop.reason} before the run had begun")
        return
    failed = failed or _failure(processes)
    if failed:
        raise RunError(failed)
    if broken := [name for name, process in processes.items() if process.returncode]:
        raise RunError(f"{', '.join(broken)} broke off")


def _failure(processes: dict[str, subprocess.Popen[bytes]]) -> str:
    """Return what is to be said of the process that failed, or nothing while there are only others that followed it.

    A killed process is the cause, whatever the others say of themselves.
    """
    codes = {name: process.poll() or 0 for name, process in processes.items()}
    for name, code in codes.items():
        if code < 0:
            return f"{name} was killed by signal {-code}"
    for name, code in codes.items():
        if code not in (0, BROKEN_OFF):
            return f"{name} ended with exit code {code}"
    return ""


def free_port() -> int:
    """Return a TCP port on loopback that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
